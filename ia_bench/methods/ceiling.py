"""Ground truth behind the method's contract: what our renderer reaches when nothing is left to be recovered.

The gap between this row and a perfect score is the renderer's (indirect light, BRDF, pixel footprint), not a method's.
"""

from __future__ import annotations

import torch

from ia_bench.common.errors import InputError
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Fit, Monitor, Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import Prior
from ia_bench.scenes.scene import Truth


class Ceiling:
    """Returns the true textures and the true light; every table marks it, because it sees ground truth."""

    sees_truth = True

    def __init__(self) -> None:
        self._truth: Truth | None = None

    def reveal_scene(self, truth: Truth) -> None:
        """Receive the scene's textures and lights from run.py."""
        self._truth = truth

    def fit(self, problem: Problem, prior: Prior, settings: FitSettings, *, seed: int, monitor: Monitor) -> Fit:
        """Nothing is optimised. Raises InputError when the scene does not ship its truth, or has metal, which it does not tell."""
        if problem.plan.metallic:
            raise InputError(f"method=ceiling: {problem.scene.source}: expected no metal, which truth does not tell, found some")
        truth = self._truth
        if truth is None or truth.albedo is None or truth.roughness is None or "train" not in truth.lights:
            raise InputError(f"method=ceiling: {problem.scene.source} ships no true textures and training light")
        device = problem.gbuffer.face.device
        albedo = torch.from_numpy(truth.albedo).float().to(device)
        roughness = torch.from_numpy(truth.roughness).float().clamp(MIN_ROUGHNESS, 1)[..., None].to(device)
        light = torch.from_numpy(truth.lights["train"]).to(device)
        return Fit(Material(albedo, roughness), light, stage="ceiling")
