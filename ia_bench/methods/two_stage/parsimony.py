"""Objects are of few materials: places that nearly agree in all that was recovered of them are made to agree.

Barron and Malik (Shape, Illumination, and Reflectance from Shading, 2015) call a small entropy of all colours of an object
parsimony, and price it while they fit. Here it is a step of mean shift (Comaniciu and Meer 2002) toward the modes of the density
of what a fit has recovered so far, taken a few times between its steps and once at its end. Light and albedo make up for each
other's errors; once one is averaged out of the albedo, the steps that follow take its counterpart out of the light. Metallic
is left alone. Nothing in it was trained.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.methods.two_stage.refinement import OFFSET
from ia_bench.scenes.color import linear_to_srgb

PASSES = 0.4, 0.5, 0.6, 0.7, 0.8, 1.0
"""Shares of a fit's steps after which places are made to agree."""
GREY, CHROMA = 0.05, 0.025
"""Bandwidths of display values along grey and across it: an error of the light is one of brightness more than of colour."""
ROUGHNESS = 0.2
"""Bandwidth of the roughness."""
REACH = 0.15
"""Bandwidth of the place, as a fraction of the diagonal of the box around all places."""
PARTNERS = 2048
"""Of each place, drawn among all."""
PLACES = 2**18
"""At most, drawn among all: large photographs show each texel in many pixels."""
BATCH = 256
"""Places whose partners are weighed together: their weights stay in a cache of the processor."""
FAINT = -100.0
"""Logarithm to base 2 of the least weight; that of a float that processors are slow at is below."""


def passes(steps: int) -> set[int]:
    """Before which of ``steps`` steps places are made to agree; ``steps`` itself is after the last one."""
    return {round(share * steps) for share in PASSES}


def pooled(albedo: Tensor, roughness: Tensor, position: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Means of albedo and roughness over partners, each weighed by exp(-|f_i - f_j|^2 / 2).

    Features f are display values, roughness and place over their bandwidths. Albedos are averaged as log(albedo + OFFSET). Partners
    are drawn among all places with the ``generator``; a place is its own one besides, with the share of places that are drawn as
    its weight, so that what nothing resembles stays as it is.

    Albedo (P, 3) linear in [0, 1], roughness (P, 1) perceptual and ``position`` (P, 3) in scene units, of P > 0 places; the first
    two come back.
    """
    features, one = _features(albedo, roughness, position), torch.ones_like(roughness)
    values = torch.cat([torch.log(albedo + OFFSET), roughness, one], 1)  # the last one sums the weights
    drawn = torch.randperm(len(albedo), generator=generator, device=albedo.device)[:PARTNERS]
    half = -0.5 * features.square().sum(1, keepdim=True)
    # Of the product of the next two, each entry is -d^2 / 2.
    places, partners = torch.cat([features, half, one], 1), torch.cat([features, one, half], 1)[drawn].T
    theirs, sums = values[drawn].T.contiguous(), len(drawn) / len(albedo) * values
    for some, total in zip(places.split(BATCH), sums.split(BATCH), strict=True):
        total += (theirs @ (some @ partners).clamp_(FAINT, 0).exp2_().T).T
    mean = sums[:, :4] / sums[:, 4:]
    return mean[:, :3].exp() - OFFSET, mean[:, 3:]


def _features(albedo: Tensor, roughness: Tensor, position: Tensor) -> Tensor:
    """(P, 8), over their bandwidths, times the root of log2(e), so that weights are powers of two."""
    shown = linear_to_srgb(albedo)
    grey = shown.mean(1, keepdim=True)
    place = position - position.mean(0)
    extent = (place.amax(0) - place.amin(0)).norm().clamp_min(1e-12)
    parts = math.sqrt(3) * grey / GREY, (shown - grey) / CHROMA, roughness / ROUGHNESS, place / (REACH * extent)
    return math.sqrt(math.log2(math.e)) * torch.cat(parts, 1)
