"""``coupling=kernel``: a prediction as a similarity kernel, which says what pixels share an albedo, whatever it is.

After Diffusion-Based Material Regularization for Physics-Based Inverse Rendering (arXiv 2606.31065): where the prediction
hardly varies the material may not vary either; the images decide everything else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import Positive, Weight
from ia_bench.material.textures import fetch
from ia_bench.methods.contract import PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.base import WeightedCoupling, per_view, points_of
from ia_bench.scenes.color import linear_to_srgb

PAIRS = 4  # partners of a pixel in one step: others follow in the next, and one is a noisy estimate (docs/log/supervision.md)
LEVEL = 0.3  # mean albedo to which a prediction of unknown scale is brought before distances are taken
LOG_FLOOR = 0.01  # added to the albedo inside the log: differences below it are no contrast that anybody sees


@dataclass(eq=False)
class Kernel(WeightedCoupling):
    """The loss: weighted mean of exp(-d^2 / 2 s^2) |log a_i - log a_j| over random pairs of pixels i, j of the same view.

    d is the Euclidean sRGB distance of the prediction at i and j, s the ``scale``, a the fit's albedo. Partners are
    drawn anew in every step, at distances uniform between one pixel and the radius: the near ones carry detail, the far
    ones reach across shading; a partner's albedo is that of one of its points, drawn at random too. Its gradient is for single
    texels: a constant that is added to many at once makes any albedo less varied. A pair counts only if
    the object fills both pixels, in the G-buffer and in the photograph's mask (an edge mixes its albedo with something
    else), and the prior was asked about the view.

    Specular shading varies with the view, so that no kernel of constant material applies: it is a target, by default of weight 0.

    Attributes:
        scale: Standard deviation of the kernel, a Euclidean distance of sRGB colours.
        radius: How far apart the pixels of a pair may be, as a fraction of the longer side of the image.
        free_scale: Whether the scale of a view's prediction means nothing, and must not change distances either.
    """

    albedo: Weight = 0.01
    specular: Weight = 0.0
    scale: Positive = 0.1
    radius: Positive = 0.5
    free_scale: bool = True

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Encode the prediction, in each view brought to the same level where its scale is free."""
        super().prepare(samples, problem)
        if "albedo" not in samples.values:
            return
        self._problem = problem
        gbuffer = problem.gbuffer
        views, self._height, self._width = gbuffer.shape
        self._reach = max(1.0, self.radius * max(self._height, self._width))
        self._filled = self._weight[:, 0].sqrt() * gbuffer.filled * (problem.photographs.mask[:, 0] > 0.999)
        prediction = samples.values["albedo"]
        if self.free_scale:
            view, used = gbuffer.view(), self._filled > 0
            mean = per_view(prediction[used], view[used], views)
            prediction = prediction * (LEVEL / mean.clamp_min(1e-6))[view][:, None]
        self._prediction = linear_to_srgb(prediction)
        self._entry = gbuffer.entry_of_pixel()

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """See the class."""
        pixels = pixels[self._filled[pixels] > 0]  # the others have no weight; most are of views that the prior was not asked about
        own, hit = points_of(pixels, self._problem)
        partner, uv, there = self._partners(pixels, render.generator)
        found = fetch(render.texture, torch.cat([own.reshape(-1, 2), uv]))  # at once: a gradient is as large as the texture
        points, theirs = found.split([hit.numel(), len(uv)])
        albedo = (points.reshape(*hit.shape, 3) * hit[..., None]).mean(1)
        here = pixels.repeat_interleave(PAIRS)
        weight = self._filled[here] * self._filled[partner] * there
        distance = (self._prediction[here] - self._prediction[partner]).square().sum(-1)
        similarity = torch.exp(-distance / (2 * self.scale**2))
        difference = torch.log(albedo + LOG_FLOOR).repeat_interleave(PAIRS, 0) - torch.log(theirs + LOG_FLOOR)
        return (weight * similarity * difference.abs().mean(-1)).sum() / weight.sum().clamp_min(1e-6)

    def _partners(self, pixels: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """A random entry near each pixel, PAIRS times: (B PAIRS,) entries, UV of a random point of each, whether there is one.

        Where there is none (0 instead of 1) the pixel itself is returned.
        """
        gbuffer = self._problem.gbuffer
        here = gbuffer.pixel[pixels].repeat_interleave(PAIRS)
        draws = torch.rand(3, len(here), generator=generator, device=here.device)
        reach, angle = 1 + (self._reach - 1) * draws[0], 2 * math.pi * draws[1]
        column = here % self._width + (reach * angle.cos()).round().long()
        row = here // self._width % self._height + (reach * angle.sin()).round().long()
        inside = (column >= 0) & (column < self._width) & (row >= 0) & (row < self._height)
        start = here - here % (self._width * self._height)
        there = torch.where(inside, start + row * self._width + column, here)
        entry = self._entry[there].long()
        found = inside & (entry >= 0)
        partner = torch.where(found, entry, pixels.repeat_interleave(PAIRS))
        point = (draws[2] * gbuffer.subsamples).long().clamp(max=gbuffer.subsamples - 1)
        face = gbuffer.face[partner, point].clamp_min(0).long()
        uv = self._problem.renderer.surface.uv(face, gbuffer.barycentric[partner, point])
        return partner, uv, found.to(draws.dtype)
