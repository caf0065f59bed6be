"""What the benchmarks of the renderer share: a shipped scene with its true material and light, at any size of view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.readers.native import NativeReader
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.stage import Stage
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Camera, Scene, Truth

if TYPE_CHECKING:
    from benchmarks.mitsuba_scene import TrackedScene

CPU = torch.device("cpu")
POINTS = 2  # G-buffer points along a side of a pixel, as the plan mostly chooses


@dataclass(frozen=True)
class TrueScene:
    """A scene with ground truth: its ``material``, its ``light`` (H, 2H, 3), its ``geometry`` ready to be asked."""

    scene: Scene
    material: Material
    light: Tensor
    geometry: Stage

    @classmethod
    def of(cls, name: str, *, light_rows: int, threads: int) -> TrueScene:
        """The shipped scene ``name`` under its training light averaged to ``light_rows``."""
        run_as_a_run(threads)
        scene = NativeReader(resolve_scene_folder(SceneConfig(name))).read(truth=True)
        light = LatLongEnvironment(torch.from_numpy(scene.truth.lights["train"])).latlong(light_rows)
        return cls(scene, true_material(scene.truth), light, Stage(scene.expect_mesh(), CPU))

    def cameras(self, views: int, size: int) -> list[Camera]:
        """``views`` training cameras, evenly strided, with images of ``size`` x ``size`` pixels."""
        chosen = np.linspace(0, len(self.scene.train) - 1, views).round().astype(int)
        return [resized(self.scene.train[view].camera, size) for view in chosen]

    def gbuffer(self, cameras: list[Camera]) -> GBuffer:
        """What the cameras see, POINTS x POINTS points a pixel."""
        return self.geometry.gbuffer(cameras, POINTS)

    def mitsuba(self, cameras: list[Camera], threads: int, integrator: str = "direct") -> TrackedScene:
        """The same for Mitsuba, whose ``integrator`` is a key of SCENES. Raises InputError where it is missing."""
        from benchmarks.mitsuba_scene import SCENES

        return SCENES[integrator](self.scene.expect_mesh(), cameras, self.material, self.light, threads=threads)


def true_material(truth: Truth) -> Material:
    """The true albedo and roughness, and metallic where there is one; what is smoother than MIN_ROUGHNESS is that."""
    grey = truth.roughness, truth.metallic
    roughness, metallic = (None if part is None else torch.from_numpy(part)[..., None].float() for part in grey)
    return Material(torch.from_numpy(truth.albedo).float(), roughness.clamp_min(MIN_ROUGHNESS), metallic)


def resized(camera: Camera, size: int) -> Camera:
    """The same camera with square images of ``size`` pixels a side."""
    factor = size / camera.width
    scaled = {name: tuple(value * factor for value in getattr(camera, name)) for name in ("focal", "centre")}
    return replace(camera, **scaled, width=size, height=size)


def run_as_a_run(threads: int) -> None:
    """Make torch work as ia_bench/runs/run.py has it."""
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    torch.utils.deterministic.fill_uninitialized_memory = False
