"""Ground truth behind the method's contract: what our renderer reaches when nothing is left to be recovered.

The gap between this row and a perfect score is the renderer's (indirect light, BRDF, pixel footprint), not a method's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.errors import InputError
from ia_bench.methods.info import MethodInfo

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


@dataclass(frozen=True)
class NoOptions:
    """There is nothing to be set."""


class Ceiling:
    """Returns the true textures on the true mesh, and the true light."""

    Options: ClassVar[type] = NoOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    info = MethodInfo(uses_prior=False, sees_truth=True)

    def __init__(self, options: NoOptions) -> None:
        """There is nothing to be set."""

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Nothing is optimised. Raises InputError when the scene does not ship its truth, or has metal, which it does not tell."""
        import torch

        from ia_bench.material.brdf import MIN_ROUGHNESS
        from ia_bench.material.textures import Material
        from ia_bench.methods.contract import Result
        from ia_bench.render.reconstruction import TexturedReconstruction
        from ia_bench.render.stage import Stage

        scene = problem.truth
        truth = None if scene is None else scene.truth
        who = f"method=ceiling: scene {problem.scene.name}"
        if problem.scene.metallic:
            raise InputError(f"{who}: expected no metal, which truth does not tell, found some")
        if truth is None or truth.albedo is None or truth.roughness is None or "train" not in truth.lights:
            raise InputError(f"{who}: expected true textures and the true training light, found that they are not shipped")
        albedo = torch.from_numpy(truth.albedo).float().to(problem.device)
        true_roughness = torch.from_numpy(truth.roughness).float()[..., None]
        roughness = true_roughness.clamp(MIN_ROUGHNESS, 1).to(problem.device)
        clamped = int((roughness.cpu() != true_roughness).sum())
        light = torch.from_numpy(truth.lights["train"]).to(problem.device)
        stage = problem.stage if truth.mesh is None else Stage(truth.mesh, problem.device)  # to which the textures belong
        recovered = TexturedReconstruction(stage, Material(albedo, roughness), light, coat=problem.render.coat)
        return Result(recovered, counters={"roughness_clamped": clamped})
