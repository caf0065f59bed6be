"""Photographs through a lens, as a pinhole camera of the same intrinsics would have taken them.

A point at (x, y) of the plane z = 1 is photographed at (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8), r^2 = x^2 + y^2, plus
(2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y): Brown's model, as OpenCV, COLMAP and nerfstudio write it (y down).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.readers.fields import number
from ia_bench.scenes.scene import View

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
BROWNS = ("OPENCV", "RADIAL", "SIMPLE_RADIAL", "perspective")
KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")
FOLDED = 1e-9  # a slope or an area below it: two points in one place


@dataclass(frozen=True)
class Lens:
    """The coefficients of Brown's model; without unit, for the plane z = 1."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def straight(self) -> bool:
        """Whether it is a pinhole."""
        return not any((self.k1, self.k2, self.k3, self.k4, self.p1, self.p2))

    def distorted(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the points (x, y) of the plane z = 1 are photographed, on the same plane."""
        square = x * x + y * y
        radial = 1 + square * (self.k1 + square * (self.k2 + square * (self.k3 + square * self.k4)))
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x),
            y * radial + self.p1 * (square + 2 * y * y) + 2 * self.p2 * x * y,
        )


def lens(where: str, frame: Mapping[str, Any]) -> Lens:
    """The lens of a frame of transforms.json: ``camera_model`` and k1, k2, k3, k4, p1, p2, each 0 where it is absent.

    Raises InputError, with its name, for a model that is none of these, and for a model that has no such coefficients.
    """
    model = frame.get("camera_model", "OPENCV")
    if model not in (*PINHOLES, *BROWNS):
        raise InputError(
            f"{where}: camera_model: expected one of {', '.join((*PINHOLES, *BROWNS))}, found {shown(repr(model))}; "
            "undistort the photographs first (colmap image_undistorter)"
        )
    found = Lens(**{key: number(where, frame, key) for key in KEYS if key in frame})
    if model in PINHOLES and not found.straight:
        raise InputError(f"{where}: camera_model: expected no distortion of a {model} camera, found {found}")
    return found


def undistorted(where: str, view: View, glass: Lens) -> View:
    """A view through ``glass`` as its pinhole camera would have seen it, bilinear.

    Pixels beyond the photograph are unknown: black, mask 0, not ``valid``.

    Raises InputError for coefficients under which the photograph folds over, which no lens has, and for an object that is lost.
    """
    if glass.straight:
        return view
    (height, width), focal, centre = view.mask.shape, view.camera.focal, view.camera.centre
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = (column - centre[0]) / focal[0], (row - centre[1]) / focal[1]
    u, v = glass.distorted(x, y)
    # The Jacobian of Brown's model is symmetric. Where it is positive definite all over a rectangle, no two points of it meet.
    slope, slant = np.gradient(u, axis=1) * focal[0], np.gradient(u, axis=0) * focal[1]
    area = slope * np.gradient(v, axis=0) * focal[1] - slant * np.gradient(v, axis=1) * focal[0]
    if min(slope.min(), area.min()) < FOLDED or not np.isfinite(area).all():
        raise InputError(f"{where}: expected the distortion of a lens, found one under which the picture folds over: {glass}")
    place = [v * focal[1] + centre[1] - 0.5, u * focal[0] + centre[0] - 0.5]
    seen = (place[0] >= -0.5) & (place[0] <= height - 0.5) & (place[1] >= -0.5) & (place[1] <= width - 0.5)

    def moved(values: np.ndarray) -> np.ndarray:
        layers = values.reshape(height, width, -1).astype(np.float32)
        found = [map_coordinates(layers[..., c], place, order=1, mode="nearest") for c in range(layers.shape[-1])]
        return (np.stack(found, -1) * seen[..., None]).reshape(values.shape)

    image, mask = moved(view.image), moved(view.mask)
    if not (mask > 0.5).any():
        raise InputError(f"{where}: expected an object within the photograph, found none once the lens is undone")
    image[mask <= 0] = 0
    valid = seen if view.valid is None else seen & (moved(~view.valid) == 0)
    return replace(view, image=image, mask=mask, valid=None if view.valid is None and seen.all() else valid)
