"""The two methods that see the truth: the ceiling, which gives it back, and the floor, one grey under one colour of light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.errors import InputError
from ia_bench.methods.info import MethodInfo

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


ROUGHNESS = 0.5
LIGHT_ROWS = 16  # all of one colour
COVERED = 0.5  # pixels that the object covers by more than this tell the mean albedo


@dataclass(frozen=True)
class NoOptions:
    """There is nothing to be set."""


class _TruthSeer:
    """A method without options that is given the truth."""

    Options: ClassVar[type] = NoOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    info = MethodInfo(uses_prior=False, sees_truth=True)

    def __init__(self, options: NoOptions) -> None:
        """There is nothing to be set."""


class Ceiling(_TruthSeer):
    """Returns the true textures on the true mesh, and the true light.

    The gap between this row and a perfect score is the renderer's (indirect light, BRDF, pixel footprint), not a method's.
    """

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Nothing is optimised. Raises InputError when the scene does not ship its truth, or does not say what of it is metal."""
        from ia_bench.methods.contract import Result
        from ia_bench.render.reconstruction import Assets, TexturedReconstruction
        from ia_bench.render.stage import Stage

        scene = problem.truth
        truth = None if scene is None else scene.truth
        who = f"method=ceiling: scene {problem.scene.name}"
        if problem.scene.metallic and (truth is None or truth.metallic is None):
            raise InputError(f"{who}: expected no metal, or a true metallic texture, found metal without")
        if truth is None or truth.albedo is None or truth.roughness is None or "train" not in truth.lights:
            raise InputError(f"{who}: expected true textures and the true training light, found that they are not shipped")
        stage = problem.stage if truth.mesh is None else Stage(truth.mesh, problem.device)  # to which the textures belong
        found = Assets(stage.mesh, truth.albedo, truth.roughness, truth.metallic, truth.lights["train"])
        return Result(TexturedReconstruction.of(found, stage, problem.scene.turning, coat=problem.render.coat))


class Constant(_TruthSeer):
    """A grey of the true mean albedo, which it sees, under the even light that explains what is known of the training images.

    A method that does not clear it has recovered nothing.
    """

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Nothing is optimised. Raises InputError when no test view has a true albedo."""
        import numpy as np
        import torch

        from ia_bench.material.textures import Material
        from ia_bench.methods.contract import Result
        from ia_bench.methods.photographs import light_of_the_mean_image
        from ia_bench.render.reconstruction import TexturedReconstruction
        from ia_bench.scenes.images import straight

        views = () if problem.truth is None else problem.truth.test
        shown = [straight(view.albedo, view.mask)[view.mask > COVERED] for view in views if view.albedo is not None]
        if not sum(map(len, shown)):
            raise InputError(f"method=constant: scene {problem.scene.name}: expected test views with true albedo, found none")
        device = problem.device
        grey = torch.full((4, 4, 3), float(np.concatenate(shown).mean(dtype=np.float64)), device=device)
        material = Material(grey, torch.full((4, 4, 1), ROUGHNESS, device=device))
        generator = torch.Generator(device=device).manual_seed(seed)
        colour, _ = light_of_the_mean_image(problem, problem.photographs.known[:, 0], material, LIGHT_ROWS, generator)
        light = colour.expand(LIGHT_ROWS, 2 * LIGHT_ROWS, 3).clone()
        return Result(TexturedReconstruction(problem.stage, material, light, coat=problem.render.coat))
