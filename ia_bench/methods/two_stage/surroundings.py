"""Pictures of a finished fit from all around the object, as a prior that corrects it is shown them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.material.textures import Material
from ia_bench.methods.asking.geometry import camera_geometry
from ia_bench.methods.contract import Problem
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Camera

CAMERAS = 32
"""So many cameras look at the object."""
LOWEST = -0.45
"""Sine of the elevation of the lowest camera; the highest is overhead."""
HALF_ANGLE = math.radians(14)
"""Between the axis of a camera and the edge of the smallest ball around the middle of the object that holds it."""
FILLED = 0.92
"""Share of the frame that the object fills."""
LARGEST = 256
"""Pixels a side of a picture at most; else it has as many as a photograph's longer side."""
SIDE = 2
"""A pixel has so many points along a side."""


def cameras_around(vertices: np.ndarray, count: int, size: int) -> list[Camera]:
    """Square cameras of ``size`` pixels that look at the middle of the box around ``vertices`` (V, 3) from a spiral of equal areas.

    The spiral is that of Vogel (1979), on the sphere above LOWEST.
    """
    middle = 0.5 * (vertices.min(0) + vertices.max(0))
    radius = float(np.linalg.norm(vertices - middle, axis=1).max())
    cameras = []
    for number in range(count):
        sine, azimuth = LOWEST + (1 - LOWEST) * (number + 0.5) / count, number * math.pi * (3 - math.sqrt(5))
        cosine = math.sqrt(1 - sine**2)
        backward = np.array([cosine * math.cos(azimuth), cosine * math.sin(azimuth), sine])
        right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        to_world = np.eye(4)
        to_world[:3] = np.column_stack(
            [right, np.cross(backward, right), backward, middle + backward * radius / math.sin(HALF_ANGLE)]
        )
        local = (vertices - to_world[:3, 3]) @ to_world[:3, :3]
        plane = local[:, :2] / -local[:, 2:]
        low, high = plane.min(0), plane.max(0)
        focal = FILLED * size / float((high - low).max())
        column, row = 0.5 * focal * (low + high)
        cameras.append(Camera(to_world, (focal, focal), (size / 2 - column, size / 2 + row), size, size))
    return cameras


@torch.no_grad()
def pictures(
    problem: Problem, gbuffer: GBuffer, cameras: Sequence[Camera], material: Material, evidence: Mapping[str, Tensor], looks: Tensor
) -> dict[str, Tensor]:
    """The ``ia_bench.priors.contract.PICTURES`` of a fit in the ``cameras`` of the ``gbuffer``, on the problem's device.

    ``material``, ``evidence`` (:mod:`ia_bench.methods.two_stage.evidence`) and ``looks`` (T, T) are its textures.
    """
    surface = problem.renderer.surface
    normals, visibility = camera_geometry(problem.renderer, gbuffer, cameras)
    textures = {"albedo": material.albedo, "roughness": material.roughness, **evidence, "looks": looks[..., None]}
    shown = {name: texture_images(surface, gbuffer, texture) for name, texture in textures.items()}
    coverage = gbuffer.coverage()[..., None]
    return {"mask": coverage, "normals": normals, "visibility": visibility, "places": _places(problem, gbuffer), **shown}


def _places(problem: Problem, gbuffer: GBuffer) -> Tensor:
    """(V, H, W, 2): height over, and distance from, the middle of the box around the object, over its diagonal, premultiplied."""
    vertices = torch.from_numpy(problem.scene.expect_mesh().vertices).to(gbuffer.barycentric)
    low, high = vertices.amin(0), vertices.amax(0)
    hit = gbuffer.face >= 0
    _, position = problem.renderer.surface.geometry(
        gbuffer.face.clamp_min(0).reshape(-1).long(), gbuffer.barycentric.reshape(-1, 2)
    )
    coverage = hit.float().mean(1, keepdim=True)
    mean = (position.reshape(*hit.shape, 3) * hit[..., None]).mean(1) / coverage.clamp_min(1e-6)
    place = (mean - 0.5 * (low + high)) / (high - low).norm().clamp_min(1e-12)
    both = torch.cat([place[:, 2:], place[:, :2].norm(dim=1, keepdim=True)], 1)
    return gbuffer.images(both * coverage)
