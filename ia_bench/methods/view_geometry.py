"""What a prior that reads geometry is given: camera-space normals and ambient visibility of the pixels."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ia_bench.material.brdf import normalize, tangent_frame
from ia_bench.methods.contract import Problem
from ia_bench.methods.views import restrict, sees
from ia_bench.render.gbuffer import GBuffer, SurfacePoints
from ia_bench.render.lattice import lattice

AMBIENT_RAYS = 32  # a pixel, shared by its points
CHUNK = 16_384  # pixels at a time


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
    rotations = np.stack([problem.scene.train[view].camera.to_world[:3, :3] for view in views]).astype(np.float32)
    to_world = torch.from_numpy(rotations).to(device)
    normals, visibility = (torch.zeros(len(gbuffer.pixel), channels, device=device) for channels in (3, 1))
    generator = torch.Generator(device=device).manual_seed(0)
    for rows in torch.arange(len(gbuffer.pixel), device=device).split(CHUNK):
        hit, points = _points(problem, gbuffer, rows)
        world = (points.normal.reshape(*hit.shape, 3) * hit[..., None]).mean(1)
        normals[rows] = torch.einsum("pi,pij->pj", world, to_world[gbuffer.view(rows)])
        visibility[rows] = _ambient(problem, hit, points, generator).mean(1, keepdim=True)
    return gbuffer.images(normals).cpu(), gbuffer.images(visibility).cpu()


@torch.no_grad()
def count_views(problem: Problem, views: tuple[int, ...]) -> Tensor:
    """How many training photographs show well (:func:`sees`) what the pixels of some of them show: (V, H, W, 1), on the CPU.

    Of a pixel its first point counts; 0 where that misses.
    """
    gbuffer, _ = restrict(problem.gbuffer, views)
    cameras = [view.camera for view in problem.scene.train]
    hit = gbuffer.face[:, 0] >= 0
    face, barycentric = gbuffer.face[hit, 0].long(), gbuffer.barycentric[hit, 0]
    points = problem.renderer.surface(face, barycentric, gbuffer.seen_from(hit))
    seen = sees(cameras, points.position, points.geometric, problem.stage.rays, problem.stage.surface.offset)
    counts = torch.zeros(len(hit), 1, device=hit.device)
    counts[hit] = seen.float().sum(1, keepdim=True)
    return gbuffer.images(counts).cpu()


def _points(problem: Problem, gbuffer: GBuffer, rows: Tensor) -> tuple[Tensor, SurfacePoints]:
    """Which points of (R,) pixels hit (R, S), and all R S points (those that miss are any)."""
    face = gbuffer.face[rows]
    camera = gbuffer.seen_from(rows).repeat_interleave(gbuffer.subsamples, 0)
    bary = gbuffer.barycentric[rows].reshape(-1, 2)
    return face >= 0, problem.renderer.surface(face.clamp_min(0).reshape(-1).long(), bary, camera)


def _ambient(problem: Problem, hit: Tensor, points: SurfacePoints, generator: torch.Generator) -> Tensor:
    """Open share of the cosine-weighted hemisphere at each point, 0 where it misses: (R, S)."""
    pixels, side = hit.shape
    count = max(1, AMBIENT_RAYS // side)
    rotation = torch.rand(pixels, 3, generator=generator, dtype=torch.float64, device=hit.device)
    samples = lattice(rotation, side, count)[..., :2].float().reshape(pixels * side, count, 2)
    direction = cosine_directions(points.normal, samples)
    asked = hit.reshape(-1, 1).expand(-1, count)
    visible = asked & ~problem.renderer.visibility.blocked(points, direction, asked)
    return visible.float().reshape(pixels, side, count).mean(-1)


def cosine_directions(normal: Tensor, samples: Tensor) -> Tensor:
    """Directions (N, K, 3) around unit normals (N, 3), of density cosine / pi, from samples (N, K, 2) in [0, 1)^2."""
    radius, angle = samples[..., 0].sqrt(), 2 * math.pi * samples[..., 1]
    tangent, bitangent = tangent_frame(normal[:, None])
    flat = tangent * (radius * angle.cos())[..., None] + bitangent * (radius * angle.sin())[..., None]
    return normalize(flat + normal[:, None] * (1 - samples[..., :1]).clamp_min(0).sqrt())
