"""Lenses: what transforms.json says of them, and photographs as a pinhole camera in the same place would have made them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.readers.cameras import number, numbers
from ia_bench.scenes.scene import View

FOLDED = 1e-9  # a slope or an area below it: two points in one place
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "RADIAL", "SIMPLE_RADIAL", "perspective")
FLAGS = {"is_fisheye": "OPENCV_FISHEYE"} | {key: key for key in ("equirectangular", "latlong", "ftheta_p0")}
"""By what key Instant-NGP says that a lens is none of these, and its name."""


@dataclass(frozen=True)
class Lens:
    """The coefficients of Brown's model, as OpenCV, COLMAP and nerfstudio write it (y down); without unit, for the plane z = 1.

    A point at (x, y) of that plane is photographed at (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8), r^2 = x^2 + y^2, plus
    (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y).
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

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

    Coefficients count whatever the model is called, and ``distortion_params``, all six in this order, before single ones, as in
    nerfstudio.

    Raises InputError, with its name, for a model that is none of these.
    """
    flagged = [name for key, name in FLAGS.items() if frame.get(key, False) is not False]
    model = flagged[0] if flagged else frame.get("camera_model", "OPENCV")
    if model not in MODELS:
        raise InputError(
            f"{where}: camera_model: expected one of {', '.join(MODELS)}, found {shown(repr(model))}; "
            "undistort the photographs first (colmap image_undistorter)"
        )
    if "distortion_params" in frame:
        listed = numbers(frame["distortion_params"])
        if listed.shape != (6,) or not np.isfinite(listed).all():
            found = shown(repr(frame["distortion_params"]))
            raise InputError(f"{where}: distortion_params: expected k1, k2, k3, k4, p1, p2 as 6 finite numbers, found {found}")
        return Lens(*listed.tolist())
    return Lens(**{key: number(where, frame, key) for key in asdict(Lens()) if key in frame})


def undistorted(where: str, view: View, glass: Lens) -> View:
    """A view through ``glass`` as its pinhole camera would have seen it, bilinear.

    Pixels beyond the photograph are unknown: black, mask 0, not ``valid``.

    Raises InputError for coefficients under which the photograph folds over, which no lens has, and for an object that is lost.
    """
    if glass == Lens():
        return view
    camera = view.camera
    through = places_of(glass, camera.focal, camera.centre, camera.height, camera.width)
    if through is None:
        raise InputError(f"{where}: expected the distortion of a lens, found one under which the picture folds over: {glass}")
    row, column, seen = through
    known, shows = view.known, (view.mask > 0) | ~view.known  # beyond which everything is 0, and stays it
    rows, columns = (np.flatnonzero(shows.any(axis)) for axis in (1, 0))
    inside = np.zeros_like(seen)
    if len(rows):
        inside = seen & (row > rows[0] - 1) & (row < rows[-1] + 1) & (column > columns[0] - 1) & (column < columns[-1] + 1)
    box = tuple(
        slice(found.min(), found.max() + 1) if len(found := np.flatnonzero(inside.any(axis))) else slice(0) for axis in (1, 0)
    )

    from scipy.ndimage import map_coordinates  # here, for most photographs are of pinhole cameras

    def moved(values: np.ndarray) -> np.ndarray:
        found = np.zeros(values.shape, np.float32)
        for source, target in zip(_layers(values.astype(np.float32)), _layers(found), strict=True):
            target[box] = map_coordinates(source, (row[box], column[box]), order=1, mode="nearest") * seen[box]
        return found

    image, mask = moved(view.image), moved(view.mask)
    if not (mask > 0.5).any():
        raise InputError(f"{where}: expected an object within the photograph, found none once the lens is undone")
    image[mask <= 0] = 0
    valid = seen & (moved(~known) == 0)
    return replace(view, image=image, mask=mask, valid=None if view.valid is None and seen.all() else valid)


def _layers(values: np.ndarray) -> list[np.ndarray]:
    """The (H, W) parts of (H, W) or (H, W, C), of which they are views."""
    return [values] if values.ndim == 2 else [values[..., channel] for channel in range(values.shape[2])]


@lru_cache(maxsize=1)  # one lens makes the photographs of a capture, or most of them one after the other
def places_of(
    glass: Lens, focal: tuple[float, float], centre: tuple[float, float], height: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Where each pixel of the pinhole camera was photographed, row and column (H, W), and whether that is in the photograph.

    None for a photograph that folds over.
    """
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    u, v = glass.distorted((column - centre[0]) / focal[0], (row - centre[1]) / focal[1])
    # The Jacobian of Brown's model is symmetric. Where it is positive definite all over a rectangle, no two points of it meet.
    slope, slant = np.gradient(u, axis=1) * focal[0], np.gradient(u, axis=0) * focal[1]
    area = slope * np.gradient(v, axis=0) * focal[1] - slant * np.gradient(v, axis=1) * focal[0]
    if min(slope.min(), area.min()) < FOLDED or not np.isfinite(area).all():
        return None
    place = v * focal[1] + centre[1] - 0.5, u * focal[0] + centre[0] - 0.5
    seen = (place[0] >= -0.5) & (place[0] <= height - 0.5) & (place[1] >= -0.5) & (place[1] <= width - 0.5)
    return *place, seen
