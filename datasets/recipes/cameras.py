"""Camera placement: deterministic poses on a sphere around the object, one distribution per split.

Poses are camera-to-world matrices in the OpenGL convention (the camera looks along its -z axis, +y is up),
as in nerfstudio's `transforms.json`. World: z up, right-handed, object inside the unit sphere at the origin.
"""

import math

import numpy as np
from numpy.typing import NDArray

FIELD_OF_VIEW = math.radians(38.0)
"""Full angle of view of the square image, radians."""

DISTANCE = 1.01 / math.sin(FIELD_OF_VIEW / 2)
"""Distance of the camera from the origin: the unit sphere fits the frame with 1 % to spare."""

LOWEST, HIGHEST = math.radians(-25.0), math.radians(80.0)
"""Elevations that training and test cameras cover."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


def camera_to_world(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose (4, 4) of a camera at `position` (3,) that looks at the origin with world z up.

    Raises:
        ValueError: if the camera looks straight up or down, where "up" is undefined.
    """
    backward = position / np.linalg.norm(position)
    right = np.cross((0.0, 0.0, 1.0), backward)
    length = np.linalg.norm(right)
    if length < 1e-6:
        raise ValueError(f"camera position must be off the z axis, got {position.tolist()}")
    right /= length
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(backward, right), backward, position
    return pose


def spherical(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Camera positions (N, 3) at DISTANCE from the origin; angles in radians, (N,) each."""
    unit = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    return DISTANCE * np.stack(unit, axis=-1)


def fibonacci(count: int, first_azimuth: float) -> NDArray[np.float64]:
    """Positions (count, 3), evenly spread over the band of elevations by a Fibonacci lattice.

    Height is stratified, so equal areas of the band get equal numbers of cameras.
    """
    index = np.arange(count)
    low, high = math.sin(LOWEST), math.sin(HIGHEST)
    height = low + (high - low) * (index + 0.5) / count
    return spherical(first_azimuth + GOLDEN_ANGLE * index, np.arcsin(height))


def spiral(count: int) -> NDArray[np.float64]:
    """Positions (count, 3) on a path that goes round twice while it swings between -10 and 60 degrees of elevation."""
    t = (np.arange(count) + 0.5) / count
    elevation = math.radians(25.0) + math.radians(35.0) * np.sin(2 * math.pi * 1.5 * t + 0.4)
    return spherical(math.radians(17.0) + 4 * math.pi * t, elevation)


def split_poses(split: str, count: int) -> NDArray[np.float64]:
    """Poses (count, 4, 4) of a split.

    Train and test share a distribution, not a camera; novel views come from a path that neither has seen.

    Raises:
        ValueError: if `split` is not train, test or novel.
    """
    match split:
        case "train":
            positions = fibonacci(count, first_azimuth=0.0)
        case "test":
            positions = fibonacci(count, first_azimuth=1.0)
        case "novel":
            positions = spiral(count)
        case _:
            raise ValueError(f"split must be train, test or novel, got {split!r}")
    return np.stack([camera_to_world(p) for p in positions])
