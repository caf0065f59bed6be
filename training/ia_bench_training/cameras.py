"""Cameras for training images: the object fills most of the frame, or is cropped by it."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from ia_bench.scenes.scene import Camera
from ia_bench_training.draws import direction_of

CROPPED = 0.2
"""Share of the images whose object is larger than the frame."""


def draw_camera(rng: Generator, vertices: np.ndarray, size: int, *, cropped: float = CROPPED) -> Camera:
    """Draw a square camera that sees the ``vertices`` (V, 3) of an object inside the unit ball, but not from straight below.

    In a share ``cropped`` of the draws the object is larger than the frame. The frame is cut from a wider photograph, so the
    principal point need not be in its middle.
    """
    elevation = math.radians(float(np.clip(rng.normal(22, 24), -30, 85)))
    azimuth, roll = rng.uniform(0, 2 * math.pi), math.radians(rng.normal(0, 4))
    half_angle = math.radians(rng.uniform(6, 28))
    backward = direction_of(elevation, azimuth)
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.cross(backward, right)
    right, up = math.cos(roll) * right + math.sin(roll) * up, math.cos(roll) * up - math.sin(roll) * right
    to_world = np.eye(4)
    to_world[:3] = np.column_stack([right, up, backward, backward / math.sin(half_angle)])

    local = (vertices - to_world[:3, 3]) @ to_world[:3, :3]
    plane = local[:, :2] / -local[:, 2:]
    low, high = plane.min(0), plane.max(0)
    extent = float((high - low).max())
    fill = rng.uniform(1.1, 1.9) if rng.random() < cropped else rng.uniform(0.7, 1.0)
    focal = fill * size / extent
    slack = abs(1 - fill) * size / 2
    middle = (low + high) / 2 * focal
    shift = rng.uniform(-0.8, 0.8, 2) * slack
    centre = (size / 2 - middle[0] + shift[0], size / 2 + middle[1] + shift[1])
    return Camera(to_world, (focal, focal), centre, size, size)
