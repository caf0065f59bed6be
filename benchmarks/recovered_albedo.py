"""Recovered beside true albedo in the test views of a table's runs, for the benchmarks that look at where it is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ia_bench.readers.native import NativeReader
from ia_bench.render.gbuffer import SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import EmbreeRays
from ia_bench.render.renderer import texture_images
from ia_bench.report.collect import Run
from ia_bench.report.recovered import read_run
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import View

INSIDE = 0.99  # coverage of a pixel that counts


@dataclass(frozen=True)
class TestViews:
    """Test views of a scene: ``mask`` (V, H, W) coverage in [0, 1], ``albedo`` (V, H, W, 3) true, linear, premultiplied."""

    views: tuple[View, ...]
    mask: np.ndarray
    albedo: np.ndarray


def recovered_albedos(runs: Sequence[Run]) -> Iterator[tuple[Run, TestViews, np.ndarray]]:
    """Each finished run, scene by scene, with its albedo (V, H, W, 3), aligned as in the scores."""
    for name in sorted({run.scene for run in runs}):
        folder = resolve_scene_folder(SceneConfig(name=name))
        assert folder is not None
        scene = NativeReader(folder).read(truth=True)
        views = tuple(view for view in scene.test if view.albedo is not None)
        surface = SurfaceInterpolator(scene.mesh, torch.device("cpu"))
        gbuffer = trace_gbuffer([view.camera for view in views], EmbreeRays(scene.mesh), 2, torch.device("cpu"))
        true = np.stack([view.albedo for view in views if view.albedo is not None])
        test = TestViews(views, gbuffer.coverage().numpy(), true)
        for run in runs:
            if run.scene == name and run.problem is None:
                recovered, _ = read_run(run.folder, folder)
                yield run, test, texture_images(surface, gbuffer, recovered.scale * recovered.material.albedo).numpy()
