"""The axis of a turntable, of the cameras that it has turned in the object's coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.geometry.hull import where_they_meet
from ia_bench.scenes.scene import View
from ia_bench.scenes.turning import TurningLight, Vector

GAP = 0.03  # of the mean radius, between the heights of two circles
LEAST = 3  # cameras on a circle
OFF = 0.02  # of the mean radius, by which cameras may miss their circles, root mean square
ENOUGH = 5  # cameras: a circle goes through any three
ON_AXIS = 0.02  # sine of the angle at which a camera stands off a given axis, below which it is on it


def turning_light(views: Sequence[View], settings: CaptureSettings, note: Callable[[str], None]) -> TurningLight:
    """How the light of ``settings``, which does not stand still, turns with the cameras of the training views.

    Raises InputError for views that are not on circles around one axis, if none is given.
    """
    poses = np.stack([view.camera.to_world for view in views])
    start: tuple[tuple[float, float, float, float], ...] = tuple(tuple(map(float, row)) for row in poses[0][:3])  # type: ignore[misc]
    if settings.light == "camera":
        return TurningLight(start)
    if settings.turntable_axis != "auto":
        axis = np.array(settings.turntable_axis)
        if not axis.any():
            raise InputError("capture.turntable_axis: expected a direction, found [0, 0, 0]")
        axis, middle = axis / np.linalg.norm(axis), where_they_meet(poses[:, :3, 3], poses[:, :3, 2])  # which is on the axis
        arms = poses[:, :3, 3] - middle
        across = np.linalg.norm(np.cross(arms, axis), axis=1) / np.linalg.norm(arms, axis=1).clip(1e-12)
        if across.min() < ON_AXIS:
            raise InputError(
                f"capture.turntable_axis: expected cameras beside the axis, found {views[int(across.argmin())].name} on it, from "
                "which nobody sees how far the object has turned; capture.light=camera needs no axis"
            )
        return TurningLight(start, _vector(axis), _vector(middle))
    circles = fitted_circles(poses)
    told = f"{100 * circles.residual:.1f} % of their mean radius off (root mean square)"
    if circles.residual > OFF or len(views) < ENOUGH:
        raise InputError(
            f"capture.light=turntable: expected {ENOUGH} cameras or more on circles around one axis, found {len(views)}, {told}; "
            "capture.turntable_axis=[x,y,z] gives an axis, and capture.light=camera needs none"
        )
    axis = circles.axis
    note(f"capture.light=turntable: {circles.count} circle(s) around [{axis[0]:.3f}, {axis[1]:.3f}, {axis[2]:.3f}], cameras {told}")
    return TurningLight(start, _vector(axis), _vector(circles.point), circles.residual)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class Circles:
    """Circles around one axis: its unit direction (3,), a point on it (3,), how many, and how far off cameras are."""

    axis: np.ndarray
    point: np.ndarray
    count: int
    residual: float


def fitted_circles(poses: np.ndarray) -> Circles:
    """The circles around one axis that the centres of cameras (V, 4, 4) are nearest to, by least squares.

    Two axes are tried: that at a right angle to what cameras have to their right, as it is where none is rolled, on however many
    circles; and the normal of the plane of all centres, as it is for one circle. Each is then refined.
    """
    from scipy.optimize import least_squares

    centres = poses[:, :3, 3].astype(float)
    found = []
    for spread in (poses[:, :3, 0], centres - centres.mean(0)):
        axis, label = np.linalg.svd(spread)[2][2], np.zeros(len(centres), int)
        for _ in range(3):  # which camera is on which circle depends on the axis
            label = _labels(centres @ axis, centres)
            basis = np.linalg.svd(axis[None])[2]  # the axis, up to its sign, and two directions across

            def off(tilt: np.ndarray, basis: np.ndarray = basis, label: np.ndarray = label) -> np.ndarray:
                return _circles(basis[0] + tilt @ basis[1:], centres, label)[1].ravel()

            axis = basis[0] + least_squares(off, np.zeros(2), loss="soft_l1", f_scale=OFF).x @ basis[1:]
            axis /= np.linalg.norm(axis)
        point, offs = _circles(axis, centres, label)
        up = np.sign(axis @ poses[:, :3, 1].sum(0)) or 1.0
        residual = float(np.sqrt(np.square(offs).sum() / len(offs)))
        found.append(Circles(up * axis, point, len(set(label)), residual))
    return min(found, key=lambda circles: circles.residual)


def _labels(height: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Which circle each camera is on, (V,), by heights along the axis; one of too few is part of the nearest."""
    radius = np.linalg.norm(centres - centres.mean(0), axis=1).mean()
    order = np.argsort(height)
    label = np.empty(len(height), int)
    label[order] = np.cumsum(np.diff(height[order], prepend=height[order[0]]) > GAP * radius)
    large = [one for one in set(label) if (label == one).sum() >= LEAST]
    if not large:
        return np.zeros(len(height), int)
    middles = np.array([np.median(height[label == one]) for one in large])
    nearest = np.abs(height[:, None] - middles).argmin(1)
    return np.where(np.isin(label, large), label, np.array(large)[nearest])


def _circles(axis: np.ndarray, centres: np.ndarray, label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point on the axis, and by how much each centre is off in height and radius, (V, 2) over the mean radius.

    With p a centre's place across the axis and c the axis', |p|^2 = 2 p . c + (what is the same all along a circle), which is
    linear in c (Kasa's fit, with one radius a circle).
    """
    axis = axis / np.linalg.norm(axis)
    across = np.linalg.svd(axis[None])[2][1:]
    place, height = centres @ across.T, centres @ axis
    member = label[:, None] == np.unique(label)
    system = np.concatenate([2 * place, member], 1)
    middle = np.linalg.lstsq(system, np.square(place).sum(1), rcond=None)[0][:2]
    radius = np.linalg.norm(place - middle, axis=1)
    sizes = member.sum(0)

    def off(values: np.ndarray) -> np.ndarray:
        distance: np.ndarray = values - (member @ (member.T @ values / sizes))
        return distance

    return middle @ across, np.stack([off(height), off(radius)], 1) / radius.mean()
