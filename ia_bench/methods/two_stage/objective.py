"""The paper's equation 5 over a batch of pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.bounds import one_sided
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.exposures import Exposures
from ia_bench.methods.two_stage.losses import dual_buffer_loss, smoothness, tone_map, total_variation
from ia_bench.methods.two_stage.neighbours import find_neighbours
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.supervision import Supervision
from ia_bench.render.renderer import PixelRadiance, samples_taken


class Objective:
    """The loss of a batch: images, what the prior says, smoothness."""

    def __init__(self, problem: Problem, settings: FitSettings) -> None:
        self._problem, self._settings = problem, settings
        self._photographs = problem.photographs
        self._neighbours = find_neighbours(problem, self._photographs.radiance, settings.smooth_scale)

    def __call__(
        self,
        pixels: Tensor,
        parameters: Parameters,
        supervision: Supervision,
        frozen: list[str],
        generator: torch.Generator,
        done: float = 0.0,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of G-buffer entries (B,), and the renders (B, 3) that are to blame first if it is not finite.

        ``done``: the share of the run's steps that are done, from 0 to 1.
        """
        settings, weights = self._settings, self._settings.weights
        material, light = parameters.material(), parameters.light(uniform=settings.defensive_share)
        unit, target, known = self._photographs.unit, self._photographs.radiance[pixels], self._photographs.known
        known = None if known is None else known[pixels]
        # ---- lambda_1: the photographs
        if settings.image_loss == "l1":
            rendered = self._render(pixels, material, light, self._problem.plan.samples, generator, parameters.exposures)
            target = one_sided(target, rendered.radiance, known)
            loss = weights.image * (tone_map(unit * rendered.radiance) - tone_map(unit * target)).abs().mean()
        else:
            both = pixels.repeat(2)
            halves = self._render(both, material, light, self._samples_a_half, generator, parameters.exposures)
            rendered = halves.averaged(2)
            first, second = (unit * halves.radiance).chunk(2)
            loss = weights.image * dual_buffer_loss(first, second, unit * target, settings.residual_cut, known)
        # ---- lambda_2, lambda_3: the prior
        if "albedo" in supervision.targets.values:
            supervised = supervision.albedo_loss(rendered.albedo, pixels, parameters.alone("albedo"), generator)
            loss = loss + weights.albedo * supervised
        if "specular" in supervision.targets.values:
            loss = loss + weights.specular * supervision.specular_loss(rendered.specular, pixels)
        # ---- lambda_4: smoothness
        loss = loss + self._smoothness(pixels, parameters.tensors, frozen)
        if weights.smooth_light:
            price = weights.smooth_light * weights.smooth_light_final**done
            loss = loss + price * total_variation(parameters.tensors["log_light"])
        return loss, {"the rendered radiance": rendered.radiance, "the rendered albedo": rendered.albedo}

    @property
    def samples_per_pixel(self) -> int:
        """Samples of a pixel in a step, as they are taken."""
        points = self._problem.gbuffer.subsamples
        if self._settings.image_loss == "l1":
            return samples_taken(self._problem.plan.samples, points)
        return 2 * samples_taken(self._samples_a_half, points)

    @property
    def _samples_a_half(self) -> int:
        """Samples of a pixel in each half of the dual-buffer loss, before the renderer rounds them."""
        return max(1, self._problem.plan.samples // 2)

    def _render(
        self,
        pixels: Tensor,
        material: Material,
        light: SampledLight,
        samples: int,
        generator: torch.Generator,
        exposures: Exposures | None,
    ) -> PixelRadiance:
        """As the photographs of these entries are exposed."""
        gbuffer = self._problem.gbuffer
        rendered = self._problem.renderer.render_pixels(gbuffer, pixels, material, light, samples, generator)
        return rendered if exposures is None else rendered.exposed(exposures.factors(gbuffer.pixel[pixels]))

    def _smoothness(self, pixels: Tensor, tensors: dict[str, Tensor], frozen: list[str]) -> Tensor:
        weights = self._settings.weights
        total = torch.zeros((), device=pixels.device)
        smooth = {"albedo": weights.smooth_albedo, "roughness": weights.smooth_roughness, "metallic": weights.smooth_roughness}
        for name, weight in smooth.items():
            texture = tensors.get(name)
            if weight and texture is not None and name not in frozen:
                total = total + weight * smoothness(texture, self._neighbours, pixels)
        return total
