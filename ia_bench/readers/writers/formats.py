"""The formats into which ``ia-bench export`` writes a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ia_bench.readers.writers.calibrated import write_colmap, write_dtu, write_llff, write_neilf
from ia_bench.readers.writers.frames import (
    write_blender,
    write_native,
    write_nerfactor,
    write_nerfstudio,
    write_stanford_orb,
    write_synthetic4relight,
    write_tensoir,
)
from ia_bench.readers.writers.parts import Write
from ia_bench.scenes.scene import Scene, View

UNCLIPPED = 0.98  # of the object's training pixels, which 8 bits hold


@dataclass(frozen=True)
class Format:
    """A format: what writes it, the reader that takes it back, and whether all its photographs are linear, so that none clips."""

    write: Write
    reader: str
    linear: bool = False


FORMATS = {
    "native": Format(write_native, "native", linear=True),
    "nerfstudio": Format(write_nerfstudio, "nerfstudio"),
    "blender-nerf": Format(write_blender, "nerfstudio"),
    "tensoir": Format(write_tensoir, "tensoir"),
    "nerfactor": Format(write_nerfactor, "nerfactor"),
    "synthetic4relight": Format(write_synthetic4relight, "synthetic4relight"),
    "stanford_orb": Format(write_stanford_orb, "stanford_orb", linear=True),
    "neilf": Format(write_neilf, "neilf", linear=True),
    "dtu": Format(write_dtu, "dtu"),
    "colmap": Format(write_colmap, "colmap"),
    "llff": Format(write_llff, "llff"),
}


def exposure(scene: Scene) -> float:
    """The factor, at most 1, that leaves UNCLIPPED of the training photographs' pixels below the white of 8 bits."""
    brightest = np.concatenate([view.image[view.mask > 0.5].max(-1) for view in scene.train])
    return float(min(1.0, 1 / max(np.quantile(brightest, UNCLIPPED), 1e-12)))


def exposed(scene: Scene, factor: float) -> Scene:
    """The scene in another unit of radiance: all photographs, at one exposure, and lights times ``factor``."""

    def brighter(view: View) -> View:
        specular = None if view.specular is None else factor * view.specular
        return replace(view, image=factor / (view.exposure or 1) * view.image, specular=specular, exposure=None)

    truth = scene.truth and replace(scene.truth, lights={name: factor * light for name, light in scene.truth.lights.items()})
    train, test, novel = (tuple(map(brighter, views)) for views in (scene.train, scene.test, scene.novel))
    return replace(scene, train=train, test=test, novel=novel, truth=truth)
