"""Recovered beside true albedo in the test views of a table's runs, for the benchmarks that look at where it is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ia_bench.readers.native import NativeReader
from ia_bench.render.stage import Stage
from ia_bench.report.collect import Run
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import View
from ia_bench.scores.protocol import Protocol

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
        stage = Stage(scene.expect_mesh(), torch.device("cpu"))
        true = np.stack([view.albedo for view in views if view.albedo is not None])
        for run in (one for one in runs if one.scene == name and one.problem is None):
            recovered = Recovered(run.folder)
            recovered.check_scene(folder)
            cameras, points = [view.camera for view in views], Protocol().map_points
            albedo = recovered.reconstruction(stage).maps(cameras, ["albedo"], points=points)["albedo"]
            yield run, TestViews(views, np.stack(albedo.coverage), true), recovered.scale.numpy() * np.stack(albedo.images)
