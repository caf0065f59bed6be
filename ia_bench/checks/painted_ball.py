"""What priors are asked about: small images of a painted ball in closed form, with everything that a prior may want to know."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ia_bench.priors.contract import WANTED, Observations

FIELD_OF_VIEW = 0.6  # radians, across the narrower side
DISTANCE = 4.2  # of the cameras from the centre of the unit ball


def painted_ball(height: int, width: int, views: int) -> Observations:
    """A unit ball with coloured bands under one directional light: Lambert's and Blinn's terms in closed form.

    Its geometry is made up: a surface that faces the camera, is half open, and which no other view shows.
    """
    pictures = [_ball_view(height, width, 2 * math.pi * view / views + 0.3) for view in range(views)]
    images, masks, albedo, specular = (torch.from_numpy(np.stack(parts)) for parts in zip(*pictures, strict=True))
    normals, truth = masks * torch.tensor([0.0, 0.0, 1.0]), {"albedo": albedo, "specular": specular}
    return Observations(images, masks[..., 0], None, normals, 0.5 * masks, (masks > 0).float(), truth)


def shown(known: Observations, wants: frozenset[str] = frozenset()) -> Observations:
    """What a prior that ``wants`` these is shown of all that is ``known``, in new memory."""
    hidden: dict[str, Any] = dict.fromkeys({*WANTED} - wants)
    return replace(known, **hidden).copy()


def _ball_view(height: int, width: int, angle: float) -> list[np.ndarray]:
    """Image, mask, albedo and specular shading from one side, each the mean of 2 x 2 points a pixel; off the ball all are 0."""
    outward = np.array([math.cos(angle), math.sin(angle), 0.4])
    outward /= np.linalg.norm(outward)
    right = np.cross([0.0, 0.0, 1.0], outward)
    right /= np.linalg.norm(right)
    focal = 0.5 * min(height, width) / math.tan(0.5 * FIELD_OF_VIEW)
    rows, columns = np.meshgrid((np.arange(2 * height) + 0.5) / 2, (np.arange(2 * width) + 0.5) / 2, indexing="ij")
    local = np.stack([(columns - 0.5 * width) / focal, -(rows - 0.5 * height) / focal, -np.ones_like(rows)], -1)
    ray = local @ np.stack([right, np.cross(outward, right), outward])
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    middle = -DISTANCE * (ray @ outward)
    discriminant = middle**2 - DISTANCE**2 + 1
    hit = (discriminant > 0)[..., None]
    normal = DISTANCE * outward + (middle - np.sqrt(discriminant.clip(0)))[..., None] * ray
    light = np.array([0.5, 0.3, 0.8]) / np.linalg.norm([0.5, 0.3, 0.8])
    half = light - ray
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    albedo = 0.45 + 0.3 * np.sin(normal @ np.array([[5.0, 1.0, 2.0], [0.0, 4.0, 3.0], [3.0, 2.0, 6.0]]))
    specular = 0.6 * (normal * half).sum(-1, keepdims=True).clip(0) ** 60 * np.ones(3)
    image = albedo * ((normal @ light).clip(0)[..., None] + 0.15) + specular
    parts = (image, np.ones_like(hit, np.float64), albedo, specular)
    return [(hit * part).reshape(height, 2, width, 2, -1).mean((1, 3)).astype(np.float32) for part in parts]
