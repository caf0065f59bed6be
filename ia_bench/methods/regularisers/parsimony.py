"""``parsimony``: objects are of few materials, so places that nearly agree in all that was recovered of them are made to agree.

Barron and Malik (Shape, Illumination, and Reflectance from Shading, 2015) call a small entropy of all colours of an object
parsimony, and price it while they fit. Here it is a step of mean shift (Comaniciu and Meer 2002) toward the modes of the density
of what a fit has recovered so far, taken a few times between its steps and once at its end. Light and albedo make up for each
other's errors; once one is averaged out of the albedo, the steps that follow take its counterpart out of the light. Metallic
is left alone. Nothing in it was trained.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import UnitInterval
from ia_bench.material.textures import Material
from ia_bench.methods.contract import FitState, Problem, Regulariser
from ia_bench.methods.regularisers.fusion import OFFSET, Fusion
from ia_bench.scenes.color import linear_to_srgb

PASSES = 0.4, 0.5, 0.6, 0.7, 0.8, 1.0
"""Shares of a fit's steps after which places are made to agree."""
GREY, CHROMA = 0.05, 0.025
"""Bandwidths of display values along grey and across it: an error of the light is one of brightness more than of colour."""
ROUGHNESS = 0.2
"""Bandwidth of the roughness."""
REACH = 0.15
"""Bandwidth of the place, as a fraction of the diagonal of the box around all places."""
PARTNERS = 1024
"""How many partners each place has, drawn among all."""
PLACES = 2**18
"""At most, drawn among all: large photographs show each texel in many pixels."""
BATCH = 256
"""Places whose partners are weighed together: their weights stay in a cache of the processor."""
FAINT = -60.0
"""Logarithm to base 2 of the least weight: its square times a roughness is still a float that processors are fast at."""


@dataclass(eq=False)
class Parsimony(Regulariser):
    """Albedo and roughness of places that the asked views show move toward the means of places that resemble them.

    Attributes:
        amount: How far they move; 0 leaves them where they are.
    """

    amount: UnitInterval = 1.0

    def prepare(self, problem: Problem) -> None:
        """Find the places."""
        self._places = Fusion(problem, problem.asked_views)

    def due(self, step: int, steps: int) -> bool:
        """After the shares PASSES of all steps; the last is at the end."""
        return step in {round(share * steps) for share in PASSES}

    def apply(self, material: Material, state: FitState) -> Material:
        """See the class; the means are :func:`pooled`."""
        fusion = self._places.drawn(PLACES, state.generator)
        if not self.amount or not fusion:
            return material
        albedo, roughness = fusion.looked_up(material.albedo), fusion.looked_up(material.roughness)
        means = pooled(albedo, roughness, fusion.position, state.generator)
        return fusion.moved(material, (albedo, means[0], self.amount), (roughness, means[1], self.amount))


def pooled(albedo: Tensor, roughness: Tensor, position: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Means of albedo and roughness over partners, each weighed by w = exp(-|f_i - f_j|^2 / 2), and by w^2 for the roughness.

    Features f are display values, roughness and place over their bandwidths. Albedos are averaged as log(albedo + OFFSET). Gloss
    varies within a colour, by wear and touch, so roughness is averaged over what is nearer in all features. Partners are drawn
    among all places with the ``generator``; a place is its own one besides, with the share of places that are drawn as its
    weight, so that what nothing resembles stays as it is.

    Albedo (P, 3) linear in [0, 1], roughness (P, 1) perceptual and ``position`` (P, 3) in scene units, of P > 0 places; the first
    two come back.
    """
    shown, place, one = linear_to_srgb(albedo), position - position.mean(0), torch.ones_like(roughness)
    grey, extent = shown.mean(1, keepdim=True), (place.amax(0) - place.amin(0)).norm().clamp_min(1e-12)
    parts = math.sqrt(3) * grey / GREY, (shown - grey) / CHROMA, roughness / ROUGHNESS, place / (REACH * extent)
    features = math.sqrt(math.log2(math.e)) * torch.cat(parts, 1)  # so that weights are powers of two
    colours, gloss = torch.cat([torch.log(albedo + OFFSET), one], 1), torch.cat([roughness, one], 1)  # the last sums the weights
    drawn = torch.randperm(len(albedo), generator=generator, device=albedo.device)[:PARTNERS]
    half = -0.5 * features.square().sum(1, keepdim=True)
    # Of the product of the next two, each entry is -d^2 / 2.
    places, partners = torch.cat([features, half, one], 1), torch.cat([features, one, half], 1)[drawn].T
    their_colours, their_gloss = (values[drawn].T.contiguous() for values in (colours, gloss))
    sums = len(drawn) / len(albedo) * torch.cat([colours, gloss], 1)
    for some, total in zip(places.split(BATCH), sums.split(BATCH), strict=True):
        weights = (some @ partners).clamp_(FAINT, 0).exp2_().T
        total[:, :4] += (their_colours @ weights).T
        total[:, 4:] += (their_gloss @ weights.square_()).T
    return (sums[:, :3] / sums[:, 3:4]).exp() - OFFSET, sums[:, 4:5] / sums[:, 5:]
