"""What all photographs together tell of a place beside its material: how far the fit is off there, and how much they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.bounds import known_pixels
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.refinement import Fusion
from ia_bench.scenes.scene import View

DARK = 0.02
"""This share of the mean of the photographs is added to both sides of a quotient of radiances, so that black has one."""
SAMPLES = 32
"""A pixel takes so many samples of the light in the renders that photographs are compared with."""
PHOTOGRAPH, ALBEDO = 0.3, 0.35
"""For the shading, photographs and albedo are multiplied such that these are their means over the object."""
OFFSET = 0.02
"""It is added to both sides of the quotient of both."""
MOST_RESIDUAL, MOST_SHADING = 4, 6
"""Stops up and down to which both are clipped."""


@torch.no_grad()
def photographed_evidence(
    problem: Problem, views: tuple[int, ...], material: Material, light: SampledLight, generator: torch.Generator
) -> dict[str, Tensor]:
    """:func:`evidence` of some training ``views``, whose renders take samples with the ``generator``."""
    part, _ = restrict(problem.gbuffer, views)
    renders = problem.renderer.render_images(part, material, light, SAMPLES, generator)
    photographs = [problem.scene.train[view] for view in views]
    return evidence(Fusion(problem.renderer.surface, part), photographs, renders, len(material.albedo))


def evidence(fusion: Fusion, views: Sequence[View], renders: Mapping[str, Tensor], size: int) -> dict[str, Tensor]:
    """Textures (size, size, C) by the names that they have among ``ia_bench.priors.contract.PICTURES``.

    ``views`` are those of the ``fusion``, ``renders`` a fit's "radiance", "specular" and "albedo" (V, H, W, 3) in them. Means are
    those of :class:`Fusion`, d is DARK of the photographs' mean, and a pixel of which only a bound is known
    (:class:`ia_bench.scenes.scene.View`) counts as one that the fit explains.

        misfit           root of the mean square of log((photograph + d) / (radiance + d)), of grey values
        shine            root of the mean square of specular / (radiance + d), of grey values
        residual         mean of log2((photograph + d) / (radiance + d)), of each channel
        shading          mean of log2((photograph - specular + o) / (albedo + o)), levels divided out, with o = OFFSET
        squared_shading  mean of the square of the mean of its channels
    """
    photographs = fusion.pixels(torch.stack([torch.from_numpy(view.image) for view in views]))
    radiance, specular, albedo = (fusion.pixels(renders[name]) for name in ("radiance", "specular", "albedo"))
    known = known_pixels(views)
    explained = 1 if known is None else fusion.pixels(known)
    dark = DARK * photographs.mean().clamp_min(1e-12)

    def grey(values: Tensor) -> Tensor:
        return values.mean(-1, keepdim=True)

    misfit = explained * torch.log((grey(photographs).clamp_min(0) + dark) / (grey(radiance).clamp_min(0) + dark))
    shine = grey(specular) / (grey(radiance) + dark)
    stops = torch.log2((photographs.clamp_min(0) + dark) / (radiance.clamp_min(0) + dark))
    residual = explained * stops.clamp(-MOST_RESIDUAL, MOST_RESIDUAL)
    level, painted = PHOTOGRAPH / photographs.mean().clamp_min(1e-6), ALBEDO / albedo.mean().clamp_min(1e-4)
    matt = ((photographs - specular) * level).clamp_min(0)
    shading = torch.log2((matt + OFFSET) / (albedo * painted + OFFSET)).clamp(-MOST_SHADING, MOST_SHADING)
    parts = {
        "misfit": misfit.square(),
        "shine": shine.square(),
        "residual": residual,
        "shading": shading,
        "squared_shading": grey(shading).square(),
    }
    means = fusion.texture(torch.cat(list(parts.values()), 1), size).split([part.shape[1] for part in parts.values()], -1)
    textures = dict(zip(parts, means, strict=True))
    return textures | {name: textures[name].clamp_min(0).sqrt() for name in ("misfit", "shine")}
