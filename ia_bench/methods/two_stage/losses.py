"""The terms of the paper's equation 5: at a step's pixels, what renders, the prior and smoothness cost.

What the prior says is compared by the run's coupling (:mod:`ia_bench.methods.couplings`); its weights are ``coupling.options``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ia_bench.common.warp_launch import launch
from ia_bench.methods.contract import Problem, StepRender
from ia_bench.methods.photographs import one_sided
from ia_bench.methods.two_stage.kernels import differences
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.gbuffer import PIXELS_AT_ONCE
from ia_bench.render.renderer import PixelRadiance, samples_taken
from ia_bench.scenes.color import tone_map

CUT, CUT_WITH_CONTROL = 0.1, 0.05
"""What ``residual_cut=auto`` is without and with a control variate of diffuse light: it belongs to the noise (docs/choices.md)."""


class Losses:
    """All losses of a batch of pixels, weighted, by name; a step descends along their sum."""

    def __init__(self, problem: Problem, settings: FitSettings, prior: PriorLoss) -> None:
        self._problem, self._settings, self._prior = problem, settings, prior
        self._photographs = problem.photographs
        cut = settings.residual_cut
        if cut == "auto":
            bounced = problem.renderer.interreflection
            controlled = bounced is not None and bounced.control is not None and problem.scene.turning is None
            cut = CUT_WITH_CONTROL if controlled else CUT
        self._cut: float = cut
        self._samples_a_half = max(1, problem.plan.samples // 2)  # of the dual-buffer loss, before the renderer rounds them
        self._pairs = neighbouring_pixels(problem, self._photographs.radiance, settings.smooth_scale)

    def __call__(
        self, pixels: Tensor, parameters: Parameters, step: int, steps: int, generator: torch.Generator
    ) -> tuple[dict[str, Tensor], PixelRadiance]:
        """The losses of G-buffer entries (B,) in ``step`` of ``steps``, and the render that they are of."""
        weights = self._settings.weights
        # ---- lambda_1: the photographs
        image, rendered = self._image(pixels, parameters, generator)
        losses = {"image": weights.image * image}
        # ---- lambda_2, lambda_3: the prior
        shown = StepRender(rendered.albedo, rendered.specular, parameters.alone("albedo"), generator)
        losses |= {f"prior: {name}": loss for name, loss in self._prior.losses(shown, pixels, step).items()}
        # ---- lambda_4: smoothness of what is optimised by now
        prices = {"albedo": weights.smooth_albedo, "roughness": weights.smooth_roughness, "metallic": weights.smooth_roughness}
        frozen = parameters.frozen(step, steps)
        for name, price in prices.items():
            if price and name in parameters.tensors and name not in frozen:
                losses[f"smooth_{name}"] = price * smoothness(parameters.tensors[name], self._pairs, pixels)
        if weights.smooth_light:
            price = weights.smooth_light * weights.smooth_light_final ** (step / max(steps - 1, 1))
            losses["smooth_light"] = price * total_variation(parameters.tensors["log_light"])
        return losses, rendered

    def _image(self, pixels: Tensor, parameters: Parameters, generator: torch.Generator) -> tuple[Tensor, PixelRadiance]:
        """The difference from the photographs, and what was rendered for it, as they are exposed."""
        settings, photographs, gbuffer = self._settings, self._photographs, self._problem.gbuffer
        material, light = parameters.material(), parameters.light(uniform=settings.defensive_share)
        unit, exposures = photographs.unit, parameters.exposures
        target, known = photographs.radiance[pixels], photographs.known[pixels]

        def render(pixels: Tensor, samples: int) -> PixelRadiance:
            rendered = self._problem.renderer.render_pixels(gbuffer, pixels, material, light, samples, generator)
            return rendered if exposures is None else rendered.exposed(exposures[gbuffer.view(pixels)])

        if settings.image_loss == "l1":
            rendered = render(pixels, self._problem.plan.samples)
            target = one_sided(target, rendered.radiance, known)
            shown, slope = _tone_mapped(unit * target)
            return (_encoded(unit * rendered.radiance, slope) - shown).abs().mean(), rendered
        halves = render(pixels.repeat(2), self._samples_a_half)
        rendered = halves.averaged(2)
        first, second = (unit * halves.radiance).chunk(2)
        return dual_buffer_loss(first, second, unit * target, self._cut, known), rendered

    @property
    def samples_per_pixel(self) -> int:
        """Samples of a pixel in a step, as they are taken."""
        points = self._problem.gbuffer.subsamples
        if self._settings.image_loss == "l1":
            return samples_taken(self._problem.plan.samples, points)
        return 2 * samples_taken(self._samples_a_half, points)


# ---- the image loss ------------------------------------------------------------------------------------------------


def dual_buffer_loss(first: Tensor, second: Tensor, target: Tensor, cut: float, known: Tensor) -> Tensor:
    """The image term of equation 5 from two independent estimates (P, 3) of the radiance that should be ``target`` (P, 3).

    Each estimate's tone-mapped difference from the target is weighed by the other one's residual, which is the difference
    times the slope of the tone map at the target, over ``cut``, within [-1, 1]; weights carry no gradient. Far from the target
    this is the L1 of tone-mapped radiance, near it a parabola. An L1 that takes residual and gradient from the same samples
    falls with the noise of the render too, and so prefers dim lights and rough surfaces; here the residual's mean is zero where
    the mean render is right, and noise pulls nowhere (but for the skewness of what is cut). The value may be negative.
    Where ``known`` (P, 1) is False, the target is a lower bound: the residual of a brighter estimate counts as zero.
    """
    shown, slope = _tone_mapped(target)

    def weight(estimate: Tensor) -> Tensor:
        residual = (slope * (estimate.detach() - target) / cut).clamp(-1, 1)
        return torch.where(known, residual, residual.clamp(max=0))

    return 0.5 * (weight(second) * (_encoded(first, slope) - shown) + weight(first) * (_encoded(second, slope) - shown)).mean()


def _tone_mapped(target: Tensor) -> tuple[Tensor, Tensor]:
    """The tone map of a target (P, 3) and its slope there."""
    with torch.enable_grad():
        at = target.detach().clamp_min(0).requires_grad_(True)
        shown = tone_map(at)
        (slope,) = torch.autograd.grad(shown.sum(), at)
    return shown.detach(), slope


def _encoded(estimate: Tensor, slope: Tensor) -> Tensor:
    """The tone map of an estimate (P, 3) of a target, below black along the ``slope`` at that target.

    A control variate makes some estimates negative. The tone map is steepest at black, where its slope is 12.9 (.6 at a radiance of
    .4): continued with that slope, the few below would outweigh the many above.
    """
    return torch.where(estimate < 0, slope * estimate, tone_map(estimate.clamp_min(0)))


# ---- smoothness ----------------------------------------------------------------------------------------------------


def total_variation(log_radiance: Tensor) -> Tensor:
    """Mean over the sphere and the channels of the slope, per radian, of an equirectangular (H, W, 3) log radiance.

    The sum of slopes along and across the parallels: a light in patches costs their borders, however bright they are.
    """
    height = len(log_radiance)
    step = math.pi / height
    parallels = torch.arange(1, height, device=log_radiance.device) * step
    along = (log_radiance - log_radiance.roll(1, 1)).abs().sum()  # over sin(polar angle) for the slope, times it for the area
    across = ((log_radiance[1:] - log_radiance[:-1]).abs() * parallels.sin()[:, None, None]).sum()
    return (along + across) * step / (4 * math.pi * log_radiance.shape[-1])


@dataclass(frozen=True)
class PixelPairs:
    """For each G-buffer pixel its right and its lower neighbour on the same piece of surface, found where UV seams do not exist.

    ``index`` (P, 2) int32 G-buffer entries, a pixel's own entry where it has no such neighbour; ``similarity`` (P, 2) in
    [0, 1], near 1 where both pixels have the same log radiance, 0 for no neighbour; ``uv`` (P, 2) of each pixel's first hit.
    """

    index: Tensor
    similarity: Tensor
    uv: Tensor


@torch.no_grad()
def neighbouring_pixels(problem: Problem, images: Tensor, scale: float) -> PixelPairs:
    """Pair neighbouring pixels of (P, 3) training radiance.

    At a difference of ``scale`` in log radiance the similarity is 1/e. Pixels whose normals differ by more than 37
    degrees, or whose distance jumps, are no pair.
    """
    gbuffer, surface = problem.gbuffer, problem.renderer.surface
    _, height, width = gbuffer.shape
    count, device = len(gbuffer.pixel), gbuffer.pixel.device
    index = torch.empty(count, 2, dtype=torch.int32, device=device)
    alike, distance, uv = index.new_empty(count, 2, dtype=torch.bool), images.new_empty(count, 2), images.new_empty(count, 2)
    for rows in gbuffer.entries_by_view():  # neighbours are of one view, and all pixels of all views are gigabytes
        if not len(rows):
            continue
        start, pixel = int(rows[0]), gbuffer.pixel[rows]
        first = (gbuffer.face[rows] >= 0).int().argmax(1)
        points = surface(gbuffer.face[rows, first].long(), gbuffer.barycentric[rows, first], gbuffer.seen_from(rows))
        uv[rows] = points.uv
        entry = rows.new_full((height * width + width,), -1)
        place = pixel % (height * width)
        entry[place] = rows
        insides = place % width < width - 1, place // width < height - 1
        for side, (inside, step) in enumerate(zip(insides, (1, width), strict=True)):
            other = torch.where(inside, entry[place + step], -1)
            other = torch.where(other < 0, rows, other)
            near = other - start
            index[rows, side] = other.int()
            distance[rows, side] = (points.position - points.position[near]).norm(dim=-1)
            alike[rows, side] = (other != rows) & ((points.normal * points.normal[near]).sum(-1) > 0.8)
    real = distance[index[:, 0] != torch.arange(count, device=device), 0]
    spacing = real.median() if len(real) else distance.new_tensor(1.0)
    log_radiance = torch.log(images.mean(-1) + 1e-3 * images.mean().clamp_min(1e-12))
    similarity = distance
    for rows in torch.arange(count, device=device).split(PIXELS_AT_ONCE):
        for side in range(2):
            other = index[rows, side].long()
            same = alike[rows, side] & (distance[rows, side] < 4 * spacing)
            change = (log_radiance[rows] - log_radiance[other]) / scale
            index[rows, side] = torch.where(same, other, rows).int()
            similarity[rows, side] = torch.where(same, torch.exp(-change * change), torch.zeros_like(change))
    return PixelPairs(index, similarity, uv)


def smoothness(texture: Tensor, pairs: PixelPairs, pixels: Tensor) -> Tensor:
    """Mean over (B,) pixels' pairs of neighbours, and over channels, of |difference| in a texture (T, T, C) times similarity."""
    value: Tensor = _Smoothness.apply(texture, pairs, pixels)
    return value


class _Smoothness(torch.autograd.Function):
    """Its gradient is found with it, and kept until it is asked for."""

    @staticmethod
    def forward(ctx: Any, texture: Tensor, pairs: PixelPairs, pixels: Tensor) -> Tensor:  # noqa: ANN401 (torch's context)
        ctx.gradient, totals = torch.zeros_like(texture), texture.new_zeros(len(pixels))
        side, _, channels = texture.shape
        launch(
            differences, len(pixels), pixels, pairs.index, pairs.similarity, pairs.uv, texture.reshape(-1), side, channels,
            1 / (2 * len(pixels) * channels), totals, sums=[ctx.gradient.view(-1)], device=texture.device,
        )  # fmt: skip
        return totals.sum()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:  # noqa: ANN401 (torch's context)
        return ctx.gradient * gradients[0], None, None
