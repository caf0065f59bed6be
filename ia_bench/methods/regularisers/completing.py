"""``context`` and ``symmetry``: guesses of what photographs show hardly, or not at all.

A pixel that sees a surface from the side says little; what photographs hardly show follows what is around it. Objects are built
around a vertical axis, so what no photograph shows resembles what is as high and as far from it. A Gaussian process (Rasmussen and
Williams 2006, equation 2.23) over these, without the angle around the axis, says what the places that photographs show let one
expect elsewhere. It is a guess, and is mixed with another, the neighbours in the texture.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import UnitInterval, Weight
from ia_bench.material.textures import Material, fill_unobserved, smooth_by_view_count, splat
from ia_bench.methods.contract import FitState, Problem, Regulariser
from ia_bench.methods.regularisers.fusion import OFFSET
from ia_bench.render.indirect import Atlas

LENGTH = 0.3
"""Distance at which the covariance exp(-d / LENGTH) has fallen to 1 / e; heights and radii are in diagonals of the object."""
SLOPE = 0.15
"""What a change of the normal by 1 counts as in these."""
NOISE = 0.1
"""Variance of what a single place says, where materials have 1."""
SHOWN = 2048
"""Places that photographs show, drawn among all."""
BATCH = 256
"""Places whose covariances are taken together: these stay in a cache of the processor."""


@dataclass(frozen=True)
class Context(Regulariser):
    """Each texel keeps n^2 / (n^2 + ``view_count``^2) of its albedo and roughness and takes the rest from around it.

    n is :func:`effective_view_count`. Albedos are mixed as log(albedo + OFFSET); metallic is left alone.

    Attributes:
        view_count: At how many photographs that look straight at it a texel keeps half.
    """

    view_count: Weight = 0.2  # chosen on development scenes (docs/log/few-photographs.md)
    completes = True

    def apply(self, material: Material, state: FitState) -> Material:
        """See the class. What no photograph shows is filled from what was so mixed."""
        if not self.view_count:
            return material
        count = effective_view_count(state.problem, len(state.observed))
        texture = torch.cat([torch.log(material.albedo + OFFSET), material.roughness], -1)
        mixed = smooth_by_view_count(texture, count, self.view_count)
        albedo, roughness = (mixed[..., :3].exp() - OFFSET).clamp_min(0), mixed[..., 3:]
        albedo, roughness = (fill_unobserved(part, state.observed) for part in (albedo, roughness))
        return Material(albedo, roughness, material.metallic)


def effective_view_count(problem: Problem, size: int) -> Tensor:
    """How many photographs look straight at each texel: (size, size), those that see it from the side by their cosine.

    The pixels that show a texel, each times the area that it has at the distance of the surface, over the area of the texel.
    Pixels that the object covers in part are left out, and those that a mask leaves out.
    """
    gbuffer, surface = problem.gbuffer, problem.renderer.surface
    gbuffer = gbuffer.at(torch.nonzero(gbuffer.filled & ~problem.photographs.left_out)[:, 0])
    face = gbuffer.face.long()
    _, position = surface.geometry(face[:, 0], gbuffer.barycentric[:, 0])
    view, backward = gbuffer.view(), gbuffer.to_world[:, :3, 2]
    focal = torch.tensor([each.camera.focal[0] * each.camera.focal[1] for each in problem.scene.train]).to(position)
    depth = -((position - gbuffer.seen_from()) * backward[view]).sum(1)
    pixel_area = depth.square() / focal[view]  # parallel to the image
    share = pixel_area * size**2 / surface.area_per_uv[face[:, 0]].clamp_min(1e-20)
    points = gbuffer.subsamples
    uv = surface.uv(face, gbuffer.barycentric).reshape(-1, 2)
    mean, count = splat(uv, (share / points).repeat_interleave(points)[:, None], size)
    return mean[..., 0] * count


@dataclass(frozen=True)
class Symmetry(Regulariser):
    """What no photograph shows moves from its neighbours in the texture toward what is :func:`expected` there.

    Mixed are the logarithm of albedo + OFFSET, and the roughness; metallic is left alone.

    Attributes:
        amount: How far it moves; at 0 it stays, 1 takes the guess alone.
    """

    amount: UnitInterval = 0.5
    completes = True

    def apply(self, material: Material, state: FitState) -> Material:
        """See the class. With nothing or all observed the material stays as it is."""
        observed, stage = state.observed, state.problem.stage
        atlas = Atlas.of(stage.mesh, len(observed), stage.device)
        seen = observed.reshape(-1)[atlas.place]
        if not self.amount or bool(seen.all()) or not bool(seen.any()):
            return material
        normal, position = stage.surface.geometry(atlas.face.long(), atlas.barycentric)
        features = around_the_axis(position, normal)
        values = torch.cat([torch.log(material.albedo + OFFSET), material.roughness], -1).reshape(-1, 4)
        shown = torch.nonzero(seen)[:, 0]
        shown = shown[torch.randperm(len(shown), generator=state.generator, device=shown.device)[:SHOWN]]
        place, guess = atlas.place[~seen], expected(features[shown], values[atlas.place[shown]], features[~seen])
        values[place] = torch.lerp(values[place], guess, self.amount)
        known = observed.reshape(-1).clone()
        known[atlas.place] = True  # the rest is no surface, and follows what is
        values = torch.cat([values[:, :3].exp() - OFFSET, values[:, 3:]], 1)
        filled, kept = fill_unobserved(values.reshape(*observed.shape, 4), known.reshape(observed.shape)), observed[..., None]
        albedo = torch.where(kept, material.albedo, filled[..., :3])
        return Material(albedo, torch.where(kept, material.roughness, filled[..., 3:]), material.metallic)


def around_the_axis(position: Tensor, normal: Tensor) -> Tensor:
    """What stays the same where an object is turned about its axis: (N, 4) of ``position`` and unit ``normal`` (N, 3).

    Height and distance from the vertical axis through the middle of the box around all places, over its diagonal, and how far
    the normal points up and away from the axis, times SLOPE.
    """
    low, high = position.amin(0), position.amax(0)
    place = (position - 0.5 * (low + high)) / (high - low).norm().clamp_min(1e-12)
    radius = place[:, :2].norm(dim=1, keepdim=True)
    outward = (normal[:, :2] * place[:, :2]).sum(1, keepdim=True) / radius.clamp_min(1e-6)
    return torch.cat([place[:, 2:], radius, SLOPE * normal[:, 2:], SLOPE * outward], 1)


def expected(shown: Tensor, values: Tensor, elsewhere: Tensor) -> Tensor:
    """The mean of a Gaussian process with covariance exp(-distance / LENGTH), given ``values`` (S, C) at ``shown`` (S, F).

    At ``elsewhere`` (N, F): (N, C). Its prior mean is that of the values.
    """
    covariance = _covariance(shown, shown)
    covariance.diagonal().add_(NOISE)
    mean = values.mean(0)
    weights = torch.linalg.solve(covariance.double(), (values - mean).double()).to(values)
    return mean + torch.cat([_covariance(some, shown) @ weights for some in elsewhere.split(BATCH)])


def _covariance(some: Tensor, others: Tensor) -> Tensor:
    distance = torch.cdist(some, others, compute_mode="donot_use_mm_for_euclid_dist")  # which would not be 0 between equals
    return distance.div_(-LENGTH).exp_()
