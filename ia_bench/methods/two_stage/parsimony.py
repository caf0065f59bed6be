"""Objects are of few materials: places that nearly agree in all that was recovered of them are made to agree.

Barron and Malik (Shape, Illumination, and Reflectance from Shading, 2015) call a small entropy of all colours of an object
parsimony, and price it while they fit. Here it is one step of mean shift (Comaniciu and Meer 2002) toward the modes of the
density of what a finished fit has recovered. Nothing in it was trained.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.methods.two_stage.refinement import OFFSET
from ia_bench.scenes.tensor_color import linear_to_srgb

GREY, CHROMA = 0.05, 0.025
"""Bandwidths of display values along grey and across it: an error of the light is one of brightness more than of colour."""
ROUGHNESS = 0.2
"""Bandwidth of the roughness."""
REACH = 0.15
"""Bandwidth of the place, as a fraction of the diagonal of the box around all places."""
PARTNERS = 2048
"""Of each place, drawn among all."""
BATCH = 8192
"""Places whose partners are weighed together."""


def pooled(albedo: Tensor, roughness: Tensor, position: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Means of albedo and roughness over partners, each weighed by exp(-|f_i - f_j|^2 / 2).

    Features f are display values, roughness and place over their bandwidths. Albedos are averaged as log(albedo + OFFSET). Partners
    are drawn among all places with the ``generator``; a place is its own one besides, with the share of places that are drawn as
    its weight, so that what nothing resembles stays as it is.

    Albedo (P, 3) linear in [0, 1], roughness (P, 1) perceptual and ``position`` (P, 3) in scene units, of P places; the first two
    come back.
    """
    features, values = _features(albedo, roughness, position), torch.cat([torch.log(albedo.clamp_min(0) + OFFSET), roughness], 1)
    drawn = torch.randperm(len(albedo), generator=generator, device=albedo.device)[:PARTNERS]
    own = len(drawn) / max(len(albedo), 1)
    partners, theirs, means = features[drawn], values[drawn], []
    for mine, value in zip(features.split(BATCH), values.split(BATCH), strict=True):
        weights = torch.exp(-0.5 * torch.cdist(mine, partners).square())
        means.append((weights @ theirs + own * value) / (weights.sum(1, keepdim=True) + own))
    mean = torch.cat(means)
    return (mean[:, :3].exp() - OFFSET).clamp(0, 1), mean[:, 3:]


def _features(albedo: Tensor, roughness: Tensor, position: Tensor) -> Tensor:
    shown = linear_to_srgb(albedo.clamp(0, 1))
    grey = shown.mean(1, keepdim=True)
    place = position - position.mean(0)
    extent = (place.amax(0) - place.amin(0)).norm().clamp_min(1e-12)
    parts = math.sqrt(3) * grey / GREY, (shown - grey) / CHROMA, roughness / ROUGHNESS, place / (REACH * extent)
    return torch.cat(parts, 1)
