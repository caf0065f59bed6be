"""What ``benchmarks/optimisers.py`` minimises: the unknowns with their parametrisations of the light, and the objective."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from benchmarks.reference import TorchRenderer, fetch
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.losses import neighbouring_pixels
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import tone_map

SMALL = 0.01  # residual below which the reweighted square takes over from L1
HELD = 8192  # pixels on which the objective is compared

Parameters = dict[str, Tensor]


@dataclass
class LightForm:
    """A parametrisation: the leaves that give the radiance of a start, and the radiance that leaves give."""

    leaves: Callable[[Tensor], Parameters]
    radiance: Callable[[Parameters, float], Tensor]  # leaves, mean radiance of the start
    least: float = -math.inf  # leaves are projected to be no smaller


def _pyramid(start: Tensor) -> Parameters:
    sizes = [start.shape[0] // 2**k for k in range(int(math.log2(start.shape[0])) + 1)]
    return {f"level{k}": torch.zeros(rows, 2 * rows, 3) for k, rows in enumerate(sizes)} | {"level0": torch.log(start)}


def _from_pyramid(leaves: Parameters, _: float) -> Tensor:
    total, side = leaves["level0"], 1
    for level in list(leaves.values())[1:]:
        side *= 2
        total = total + level.repeat_interleave(side, 0).repeat_interleave(side, 1)
    return torch.exp(total)


FORMS = {
    "log": LightForm(lambda start: {"log": torch.log(start)}, lambda p, _: torch.exp(p["log"])),
    "linear": LightForm(lambda start: {"linear": start / start.mean()}, lambda p, mean: mean * p["linear"], 1e-4),
    "softplus": LightForm(
        lambda start: {"inner": torch.log(torch.expm1(start / start.mean()))}, lambda p, mean: mean * F.softplus(p["inner"])
    ),
    "log + scale": LightForm(
        lambda start: {"log": torch.log(start), "scale": torch.zeros(1, 1, 3)}, lambda p, _: torch.exp(p["log"] + p["scale"])
    ),
    "log pyramid": LightForm(_pyramid, _from_pyramid),
}


class Unknowns:
    """The leaves of one case, and the material and light that they stand for."""

    def __init__(self, start: TexturedReconstruction, form: LightForm) -> None:
        assert start.environment is not None
        light = start.environment.texels
        self._form, self._mean = form, float(light.mean())
        self.light = {name: leaf.clone().requires_grad_() for name, leaf in form.leaves(light).items()}
        self.textures = {
            "albedo": start.material.albedo.clone().requires_grad_(), "roughness": start.material.roughness.clone().requires_grad_()
        }  # fmt: skip

    def moving(self, progress: float, settings: FitSettings) -> Parameters:
        """The leaves that are optimised by now."""
        starts = {"albedo": settings.albedo_start, "roughness": settings.roughness_start}
        return {**self.light, **{name: leaf for name, leaf in self.textures.items() if progress >= starts[name]}}

    def material(self) -> Material:
        """Differentiable."""
        return Material(self.textures["albedo"], self.textures["roughness"])

    def radiance(self) -> Tensor:
        """Of the light, (H, W, 3), differentiable."""
        return self._form.radiance(self.light, self._mean)

    @torch.no_grad()
    def project(self) -> None:
        """Back into the valid range."""
        self.textures["albedo"].clamp_(0, 1)
        self.textures["roughness"].clamp_(MIN_ROUGHNESS, 1)
        for leaf in self.light.values():
            leaf.clamp_(min=self._form.least)

    def reconstruction(self, stage: Stage) -> TexturedReconstruction:
        """As they stand now."""
        material = Material(*(leaf.detach() for leaf in self.textures.values()))
        return TexturedReconstruction(stage, material, self.radiance().detach(), coat="added")


class Objective:
    """The trainer's objective without a prior: sums of weighted absolute residuals."""

    def __init__(self, problem: Problem, settings: FitSettings) -> None:
        self.problem, self._settings, self._renderer = problem, settings, TorchRenderer(problem.renderer)
        self._images = problem.pixels_of(torch.stack([torch.from_numpy(view.image) for view in problem.scene.train]))
        self._neighbours = neighbouring_pixels(problem, self._images, settings.smooth_scale)
        self.pixel_count = len(problem.gbuffer.pixel)
        self.held = torch.randperm(self.pixel_count, generator=torch.Generator().manual_seed(7))[:HELD]

    def residuals(
        self, unknowns: Unknowns, pixels: Tensor, seed: int, sampled: SampledLight | None = None
    ) -> tuple[Tensor, Tensor]:
        """Signed residuals (M,) and their weights (M,); ``seed`` fixes the samples, ``sampled`` the light they follow."""
        problem, weights, near = self.problem, self._settings.weights, self._neighbours
        radiance = unknowns.radiance()
        light = (
            SampledLight.of(radiance, uniform_fraction=self._settings.defensive_share)
            if sampled is None
            else SampledLight(radiance, sampled.sampler)
        )
        rendered = self._renderer.render_pixels(
            problem.gbuffer, pixels, unknowns.material(), light, problem.plan.samples, torch.Generator().manual_seed(seed)
        )
        image = (tone_map(rendered.radiance) - tone_map(self._images[pixels])).reshape(-1)
        parts, shares = [image], [torch.full_like(image, weights.image / len(image))]
        uv, other = near.uv[pixels].repeat_interleave(2, 0), near.index[pixels].reshape(-1)
        similarity = near.similarity[pixels].reshape(-1, 1)
        for name, weight in (("albedo", weights.smooth_albedo), ("roughness", weights.smooth_roughness)):
            texture = unknowns.textures[name]
            step = fetch(texture, uv) - fetch(texture, near.uv[other])
            parts.append(step.reshape(-1))
            shares.append((weight / step.numel() * similarity).expand_as(step).reshape(-1))
        return torch.cat(parts), torch.cat(shares)

    def squares(self, unknowns: Unknowns, pixels: Tensor, seed: int) -> tuple[Tensor, float]:
        """Residuals (M,) whose half sum of squares has, where they were recorded, the gradient of the weighted L1; that L1."""
        residual, weight = self.residuals(unknowns, pixels, seed)
        size = residual.detach().abs()
        return residual * (weight / size.clamp_min(SMALL)).sqrt(), float((size * weight).sum())
