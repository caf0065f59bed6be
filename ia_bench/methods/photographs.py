"""What the training photographs show in a G-buffer's pixels, how far each can be believed, and which a prior is asked about."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import normalize, tangent_frame
from ia_bench.material.textures import Material
from ia_bench.render.estimator import lattice
from ia_bench.render.gbuffer import GBuffer, SurfacePoints, sees
from ia_bench.scenes.scene import Scene, View, farthest_first

if TYPE_CHECKING:
    from ia_bench.methods.contract import Problem

INSIDE = 0.4
"""A mask of no more than that leaves a pixel out. Of one that the mesh just fills, a camera's filter may show less than a half."""
PIXELS = 8192
"""At most, of the render that tells the light of the mean image."""
USUAL, LEVEL = (0.04, 4.0), 0.2
"""Photographs whose mean radiance lies in the range USUAL, as in all scenes by which prices and weights were chosen, are compared
as they are, others as if it were LEVEL: what a fit finds must not depend much on the unit of the radiance."""
AMBIENT_RAYS = 32  # a pixel, shared by its points
CHUNK = 16_384  # pixels at a time
COUNTED = 128
"""Cells along the diagonal of an object, in each of which photographs are counted once."""


@dataclass(frozen=True)
class Photographs:
    """The P pixels in which training cameras see the mesh, as the photographs have them.

    Attributes:
        radiance: (P, 3), linear, premultiplied by the mask.
        mask: (P, 1), the share of the pixel that the object fills, as the photograph's mask has it.
        known: (P, 1) bool, True where the photograph's value is the radiance, False where it is only a lower bound (saturated), and
            in pixels that are ``left_out``.
        left_out: (P,) bool, where the mesh fills the pixel and the mask leaves it out: wrong masks and poses, a margin that a
            capture cuts off, a mesh that is too large. Nothing that was made of the photograph says anything there.
        unit: Factor of radiance, of photographs and renders alike, at which a loss of absolute radiance compares them.
    """

    radiance: Tensor
    mask: Tensor
    known: Tensor
    left_out: Tensor
    unit: float = 1.0

    @classmethod
    def of(cls, scene: Scene, gbuffer: GBuffer) -> Photographs:
        """Those of a ``scene``, whose training cameras the ``gbuffer`` is of; on its device."""
        radiance, mask, known = (in_pixels(scene.train, name, gbuffer) for name in ("image", "mask", "known"))
        left_out = gbuffer.filled & (mask[:, 0] <= INSIDE)
        inside = radiance[mask[:, 0] > INSIDE]
        mean, (least, most) = float(inside.mean()) if len(inside) else 0.0, USUAL
        unit = 1.0 if least <= mean <= most or not 0 < mean < float("inf") else LEVEL / mean
        return cls(radiance, mask, known & ~left_out[:, None], left_out, unit)

    @property
    def mean_radiance(self) -> Tensor:
        """The mean (3,) over the pixels that are not left out; over all where none is left."""
        inside = self.radiance[~self.left_out]
        return (inside if len(inside) else self.radiance).mean(0)


def as_photographed(renders: Mapping[str, Tensor], views: tuple[int, ...], exposures: Tensor | None) -> dict[str, Tensor]:
    """``renders`` (V', H, W, C) of some ``views`` with those that are radiance exposed as these photographs are."""
    if exposures is None:
        return dict(renders)
    factor = exposures[list(views), None, None]
    return {name: images if name == "albedo" else factor * images for name, images in renders.items()}


def stacked(views: Sequence[View], name: str) -> Tensor:
    """What views of one size have by a ``name`` of :class:`View`, such as "mask": (V, H, W, ...), on the CPU."""
    return torch.from_numpy(np.stack([getattr(view, name) for view in views]))


def in_pixels(views: Sequence[View], name: str, gbuffer: GBuffer) -> Tensor:
    """What views have by a ``name`` in the pixels of their ``gbuffer``, (P, C), on its device; one whole view at a time is held."""
    size, device = math.prod(gbuffer.shape[1:]), gbuffer.pixel.device
    first = stacked(views[:1], name)
    found = torch.empty(len(gbuffer.pixel), math.prod(first.shape[3:]), dtype=first.dtype, device=device)
    for number, (view, entries) in enumerate(zip(views, gbuffer.entries_by_view(), strict=True)):
        values = stacked([view], name).to(device).reshape(size, -1)
        found[entries] = values.index_select(0, gbuffer.pixel[entries] - number * size)  # refuses what lies in another view
    return found


def one_sided(target: Tensor, rendered: Tensor, known: Tensor) -> Tensor:
    """What a loss compares ``rendered`` (N, 3) with: ``target`` (N, 3), or the render itself where it may be that bright.

    Where ``known`` (N, 1) is False, the target is a lower bound: a brighter render equals what it is compared with, so that any
    loss of their difference is at its least there and has no gradient.
    """
    return torch.where(known, target, torch.maximum(target, rendered.detach()))


# ---- the even light under which a material looks as bright, and of the colour, as the photographs do in the mean ----


@torch.no_grad()
def light_of_the_mean_image(
    problem: Problem, believed: Tensor, material: Material, rows: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Radiance (3,) of that light, with the render that tells it, as images are linear in the light: (P, 3) under light 1.

    The mean is taken over the pixels of the G-buffer that are ``believed`` (P,) bool, or all where none is; ``rows``: of the
    lat-long map that holds the light.
    """
    gbuffer, entries = problem.gbuffer, torch.nonzero(believed if bool(believed.any()) else torch.ones_like(believed))[:, 0]
    pixels = entries[torch.randint(len(entries), (min(PIXELS, len(entries)),), generator=generator, device=entries.device)]
    ones = SampledLight.of(torch.ones(rows, 2 * rows, 3, device=gbuffer.pixel.device))
    rendered = problem.renderer.render_pixels(gbuffer, pixels, material, ones, problem.plan.samples, generator).radiance
    mean = problem.photographs.radiance[entries].mean(0)
    return mean.clamp_min(1e-30) / rendered.mean(0).clamp_min(1e-8), rendered


# ---- some of the training views: which ones a prior is asked about, their part of the G-buffer ----


def evenly_spread(scene: Scene, count: int | str) -> tuple[int, ...]:
    """At most ``count`` training views ("all": every one) in their order, spread over the directions of the cameras."""
    return tuple(sorted(spreading_order(scene, len(scene.train) if count == "all" else int(count))))


def spreading_order(scene: Scene, count: int) -> list[int]:
    """The first ``count`` training views by farthest-point sampling of the directions from the mesh to the cameras."""
    vertices = scene.expect_mesh().vertices
    return farthest_first(scene.train, 0.5 * (vertices.min(0) + vertices.max(0)))[:count]


def views_needed(seen: Tensor, per_point: int, share: float) -> int:
    """How many of the views, in the order of the columns of ``seen`` (N, V) bool, show the points often enough.

    At least ``share`` of the points (of those that any view sees) by ``per_point`` views each, or by all that see them.
    """
    counts = seen.long().cumsum(1)
    counts = counts[counts[:, -1] > 0]
    if not len(counts):
        return seen.shape[1]
    wanted = counts[:, -1:].clamp(max=per_point)
    enough = (counts >= wanted).double().mean(0)
    return int((enough >= share).int().argmax()) + 1


def restrict(gbuffer: GBuffer, views: tuple[int, ...]) -> tuple[GBuffer, Tensor]:
    """The G-buffer of some views (ascending), and the entries (P',) of the whole one that it holds."""
    count, height, width = gbuffer.shape
    rank = torch.full((count,), -1, device=gbuffer.pixel.device)
    rank[list(views)] = torch.arange(len(views), device=rank.device)
    place = rank[gbuffer.view()]
    rows = torch.nonzero(place >= 0)[:, 0]
    part = gbuffer.at(rows)
    pixel = place[rows] * (height * width) + part.pixel % (height * width)
    return replace(part, pixel=pixel, to_world=gbuffer.to_world[list(views)], shape=(len(views), height, width)), rows


# ---- what a prior that reads geometry is given ----


@torch.no_grad()
def view_geometry(problem: Problem, views: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Normals (V, H, W, 3) and visibility (V, H, W, 1) of some training views, as observations hold them.

    Both are box-filtered over the pixel's points like every premultiplied image, as in the data that priors are trained on.
    Visibility is estimated from about 32 cosine-distributed directions a pixel, as many for each of its points, asked of the
    renderer's own shadows; a convex object, for which the plan leaves shadows out, is open everywhere. On the CPU, like
    everything a prior is given.
    """
    gbuffer, _ = restrict(problem.gbuffer, views)
    device = gbuffer.face.device
    normals, visibility = (torch.zeros(len(gbuffer.pixel), channels, device=device) for channels in (3, 1))
    generator, side = torch.Generator(device=device).manual_seed(0), gbuffer.subsamples
    count = max(1, AMBIENT_RAYS // side)
    for rows in torch.arange(len(gbuffer.pixel), device=device).split(CHUNK):
        face, camera = gbuffer.face[rows], gbuffer.seen_from(rows).repeat_interleave(side, 0)
        hit, barycentric = face >= 0, gbuffer.barycentric[rows].reshape(-1, 2)
        points = problem.renderer.surface(face.reshape(-1).long(), barycentric, camera)
        world = (points.normal.reshape(*hit.shape, 3) * hit[..., None]).mean(1)
        normals[rows] = torch.einsum("pi,pij->pj", world, gbuffer.to_world[gbuffer.view(rows), :3, :3])
        rotation = torch.rand(len(rows), 3, generator=generator, dtype=torch.float64, device=device)
        samples = lattice(rotation, side, count)[..., :2].float().reshape(-1, count, 2)
        asked = hit.reshape(-1, 1).expand(-1, count)
        open_there = asked & ~problem.renderer.blocked(points, cosine_directions(points.normal, samples), asked)
        visibility[rows] = open_there.float().reshape(*hit.shape, count).mean(-1).mean(1, keepdim=True)
    return gbuffer.images(normals).cpu(), gbuffer.images(visibility).cpu()


@torch.no_grad()
def count_views(problem: Problem, views: tuple[int, ...]) -> Tensor:
    """How many training photographs show well (:func:`sees`) what the pixels of some of them show: (V, H, W, 1), on the CPU.

    Of a pixel its first point counts, 0 where that misses. Points in the same cell, of COUNTED along the diagonal of the box
    around all, that face the same octant are counted as one of them is: pixels of many photographs lie side by side.
    """
    (gbuffer, _), stage = restrict(problem.gbuffer, views), problem.stage
    hit = gbuffer.face[:, 0] >= 0
    counts = torch.zeros(len(hit), 1, device=hit.device)
    if not bool(hit.any()):
        return gbuffer.images(counts).cpu()
    points = stage.surface(gbuffer.face[hit, 0].long(), gbuffer.barycentric[hit, 0], gbuffer.seen_from(hit))
    _, chosen, group = np.unique(_cells(points).cpu().numpy(), return_index=True, return_inverse=True)
    cameras = [view.camera for view in problem.scene.train]
    seen = sees(cameras, points.position[chosen], points.geometric[chosen], stage.rays, stage.surface.offset)
    counts[hit] = seen.sum(1, keepdim=True).float()[group]
    return gbuffer.images(counts).cpu()


def _cells(points: SurfacePoints) -> Tensor:
    """Numbers (N,) int64 of the cells, as :func:`count_views` has them, in which points are."""
    low, high = torch.aminmax(points.position, dim=0)
    place = ((points.position - low) * (COUNTED / (high - low).norm().clamp_min(1e-12))).long()
    digits = torch.cat([place, (points.geometric > 0).long()], 1)
    return (digits * digits.new_tensor([(2 * COUNTED) ** power for power in range(6)])).sum(1)


def cosine_directions(normal: Tensor, samples: Tensor) -> Tensor:
    """Directions (N, K, 3) around unit normals (N, 3), of density cosine / pi, from samples (N, K, 2) in [0, 1)^2."""
    radius, angle = samples[..., 0].sqrt(), 2 * math.pi * samples[..., 1]
    tangent, bitangent = tangent_frame(normal[:, None])
    flat = tangent * (radius * angle.cos())[..., None] + bitangent * (radius * angle.sin())[..., None]
    return normalize(flat + normal[:, None] * (1 - samples[..., :1]).clamp_min(0).sqrt())
