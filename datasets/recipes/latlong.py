"""Lat-long light images: directions of texels, solid angles, rasterising a function of direction.

Convention, identical with Blender's unrotated equirectangular environment texture: image (H, 2H, 3), row 0 = +z.
The centre of texel (r, c) is theta = pi (r + 0.5) / H from +z, phi = pi - 2 pi (c + 0.5) / W from +x toward +y,
direction = (sin theta cos phi, sin theta sin phi, cos theta). Radiance is constant inside a texel.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

CONVENTION = (
    "lat-long (H, W, 3), row 0 = +z; centre of texel (r, c): theta = pi (r+0.5)/H from +z, "
    "phi = pi - 2 pi (c+0.5)/W from +x toward +y, direction = (sin theta cos phi, sin theta sin phi, cos theta); "
    "radiance is constant inside a texel"
)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Rec.709 weights of linear red, green, blue."""

SUBSAMPLES = 3
"""A texel is the mean of this many by this many samples, so that the edge of a small sun is antialiased."""

Radiance = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Unit directions (..., 3) to linear Rec.709 radiance (..., 3)."""


def texel_directions(height: int) -> NDArray[np.float64]:
    """Unit directions (H, 2H, 3) of the texel centres."""
    theta = np.pi * (np.arange(height) + 0.5) / height
    phi = np.pi - 2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height)
    sin_theta = np.sin(theta)[:, None]
    z = np.broadcast_to(np.cos(theta)[:, None], (height, 2 * height))
    return np.stack([sin_theta * np.cos(phi), sin_theta * np.sin(phi), z], axis=-1)


def direction_to_texel(directions: NDArray[np.float64], height: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column, each (...), of the texel that contains each unit direction (..., 3)."""
    theta = np.arccos(np.clip(directions[..., 2], -1.0, 1.0))  # |z| may exceed 1 by rounding
    phi = np.arctan2(directions[..., 1], directions[..., 0])
    row = np.minimum((theta / np.pi * height).astype(np.intp), height - 1)
    column = ((np.pi - phi) / np.pi * height).astype(np.intp) % (2 * height)
    return row, column


def solid_angles(height: int) -> NDArray[np.float64]:
    """Exact solid angle of a texel of each row, (H, 1) steradians; all texels together make 4 pi."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return ((edges[:-1] - edges[1:]) * np.pi / height)[:, None]


def mean_luminance(light: NDArray[np.floating]) -> float:
    """Mean luminance over the sphere of a light (H, 2H, 3).

    It equals the mean radiosity / pi of a white diffuse sphere: averaging max(0, n.w) over all normals gives 1/4,
    so the sphere's mean irradiance is pi times the mean radiance.
    """
    luminance = light.astype(np.float64) @ LUMINANCE
    return float((luminance * solid_angles(light.shape[0])).sum() / (4 * np.pi))


def rasterise(radiance: Radiance, height: int, brightness: float) -> NDArray[np.float32]:
    """Light (H, 2H, 3) of a radiance function, scaled to mean luminance `brightness`.

    Raises:
        ValueError: if the function returns a negative or non-finite value.
    """
    fine = radiance(texel_directions(height * SUBSAMPLES))
    if not np.isfinite(fine).all() or fine.min() < 0:
        raise ValueError(f"radiance must be finite and non-negative, got minimum {fine.min()}")
    light = fine.reshape(height, SUBSAMPLES, 2 * height, SUBSAMPLES, 3).mean(axis=(1, 3))
    return (light * (brightness / mean_luminance(light))).astype(np.float32)
