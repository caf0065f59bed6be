"""The axis of a turntable, of the cameras that it has turned in the object's coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.geometry.hull import where_they_meet
from ia_bench.scenes.scene import View
from ia_bench.scenes.turning import Round, TurningLight, Vector

GAP = 0.03  # of the mean radius, between the heights of two circles
LEAST = 3  # cameras on a circle
OFF = 0.02  # of the mean radius, by which cameras may miss their circles, root mean square
ENOUGH = 5  # cameras, each in a place of its own: a circle goes through any three
MEMBER = 0.1  # of its radius, within which a camera belongs to a round: its roll counts, too
ROLL = 0.12  # sine of the angle by which a camera may be rolled about the axis of its round
APART = 0.1  # sine of the angle between the right of two cameras from which they tell an axis
PAIRED = 100  # cameras at most
REFITS = 3  # times that what belongs together is told again from what was fitted
ON_AXIS = 0.02  # sine of the angle at which a camera stands off a given axis, below which it is on it
EXPECTED = f"capture.light=turntable: expected {ENOUGH} cameras or more on circles around one axis"
OR_ELSE = "capture.turntable_axis=[x,y,z] gives an axis, and capture.light=camera needs none"


def turning_light(views: Sequence[View], settings: CaptureSettings, note: Callable[[str], None]) -> TurningLight:
    """How the light of ``settings``, which does not stand still, turns with the cameras of the training views.

    Raises InputError, if no axis is given, for views in fewer than ENOUGH places or on no circles around one axis, or around one
    after another where the object was laid down anew; for a camera on the axis; and for an axis of zeros.
    """
    poses = np.stack([view.camera.to_world for view in views])
    start: tuple[tuple[float, float, float, float], ...] = tuple(tuple(map(float, row)) for row in poses[0][:3])  # type: ignore[misc]
    if settings.light == "camera":
        return TurningLight(start)
    if settings.turntable_axis != "auto":
        axis = np.array(settings.turntable_axis, float)
        if not axis.any():
            raise InputError("capture.turntable_axis: expected a direction, found [0, 0, 0]")
        axis /= np.linalg.norm(axis)
        given = TurningLight(start, (Round(_vector(axis), _vector(_point_on(axis, poses))),))
        _expect_beside(given, views, poses)
        return given
    places = len(np.unique(poses[:, :3, 3], axis=0))
    if places < ENOUGH:  # poses of the room, in which the object turned, among them: those are all in one place
        raise InputError(f"{EXPECTED}, found {len(views)} cameras in {places} place(s); {OR_ELSE}")
    rounds, residual = fitted_rounds(poses)
    told = f"{100 * residual:.1f} % of their mean radius off (root mean square)"
    downward = int((_up(poses, np.array(rounds[0].axis)) @ rounds[0].axis <= 0).sum()) if len(rounds) == 1 else 0
    if downward:
        told += f", {downward} of them upside down"
    if residual > OFF or downward:
        raise InputError(f"{EXPECTED}, found {len(views)}, {told}; {OR_ELSE}")
    around = " and ".join(
        f"{len(one.circles)} circle(s) around [{', '.join(f'{part:.3f}' for part in one.axis)}]" for one in rounds
    )
    note(f"capture.light=turntable: {around}, cameras {told}")
    fitted = TurningLight(start, rounds, residual)
    if len(rounds) > 1:
        counts = " and ".join(map(str, np.bincount(fitted.rounds_of(poses))))
        note(
            f"capture.light=turntable: the object was laid down anew between {counts} photographs; camera and lamps are taken "
            "to have stayed"
        )
    _expect_beside(fitted, views, poses)
    return fitted


def _expect_beside(turning: TurningLight, views: Sequence[View], poses: np.ndarray) -> None:
    """Raises InputError for a camera on the axis of its round, from which nobody sees how far the object has turned."""
    for view, pose, number in zip(views, poses, turning.rounds_of(poses), strict=True):
        across, height = turning.rounds[number].arms(pose[None, :3, 3])
        if np.linalg.norm(across) < ON_AXIS * np.hypot(np.linalg.norm(across), height[0]):
            raise InputError(
                f"capture.light=turntable: expected cameras beside the axis, found {view.name} on it, from which nobody sees how "
                "far the object has turned; capture.light=camera needs no axis"
            )


def _point_on(axis: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """A point (3,) on a given axis: that of the circles around it; or where cameras look, if they are on none or too few for it."""
    centres, seen = poses[:, :3, 3], where_they_meet(poses[:, :3, 3], poses[:, :3, 2])
    if len(np.unique(centres, axis=0)) < ENOUGH:
        return seen
    point, offs, _ = _circles(axis, centres, _labels(centres @ axis, centres))
    return point + (seen @ axis) * axis if np.square(offs).sum() <= len(offs) * OFF**2 else seen


def _up(poses: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """What is up in photographs, or down in all, (V, 3): poses are of pixels as they are stored, maybe of a camera on its side."""
    return poses[:, :3, int(np.abs(poses[:, :3, 0] @ axis).mean() <= np.abs(poses[:, :3, 1] @ axis).mean())]


def _vector(values: np.ndarray) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def fitted_rounds(poses: np.ndarray) -> tuple[tuple[Round, ...], float]:
    """Circles around one axis, or around few where the object was laid down anew; cameras (V, 4, 4) are all on some of them.

    Also how far the cameras are off, root mean square over the mean radius of their round.

    Where one axis does not do, the axis is taken that most cameras stand upright around, those off its circles are dropped, and
    what is left goes on to the next axis. One axis for all comes back, however far off they are, where others do no better.
    """
    whole, residual = fitted_circles(poses)
    one = (whole,), residual
    upright = (_up(poses, np.array(whole.axis)) @ whole.axis > 0).all()  # or an object was turned over, which reverses the axis
    if residual <= OFF and upright:
        return one
    rest, found, squares = np.arange(len(poses)), list[Round](), 0.0
    while len(rest) >= ENOUGH:
        members = rest[_upright(poses[rest])]
        for _ in range(REFITS):
            if len(members) < ENOUGH:
                return one
            circles, residual = fitted_circles(poses[members])
            fitted, members = members, rest[circles.distance(poses[rest]) < MEMBER**2]
        found.append(circles)
        squares += len(fitted) * residual**2
        rest = np.setdiff1d(rest, fitted)
    return one if len(rest) else (tuple(found), float(np.sqrt(squares / len(poses))))


def _upright(poses: np.ndarray) -> np.ndarray:
    """Which cameras, (V,) bool, stand upright around one axis: that of any two which is at a right angle to the right of most.

    Of many cameras PAIRED are paired, evenly chosen, for their number counts squared.
    """
    right, up = poses[:, :3, 0], poses[:, :3, 1]
    some = right[np.linspace(0, len(right) - 1, min(len(right), PAIRED)).round().astype(int)]
    axes = np.cross(some[:, None], some[None]).reshape(-1, 3)
    length = np.linalg.norm(axes, axis=1)
    axes = axes[length > APART] / length[length > APART, None]
    upright = (np.abs(axes @ right.T) < ROLL) & (axes @ up.T > 0)
    best: np.ndarray = upright[upright.sum(1).argmax()] if len(axes) else np.ones(len(poses), bool)
    return best


def fitted_circles(poses: np.ndarray) -> tuple[Round, float]:
    """The circles around one axis that the centres of cameras (V, 4, 4) are nearest to, by least squares.

    Also how far they are off, root mean square over their mean radius.

    Two axes are tried: that at a right angle to what cameras have to their right, as it is where none is rolled, on however many
    circles; and the normal of the plane of all centres, as it is for one circle. Each is then refined.
    """
    from scipy.optimize import least_squares

    centres = poses[:, :3, 3].astype(float)
    found = []
    for spread in (poses[:, :3, 0], centres - centres.mean(0)):
        axis, label = np.linalg.svd(spread)[2][2], np.zeros(len(centres), int)
        for _ in range(REFITS):  # which camera is on which circle depends on the axis
            label = _labels(centres @ axis, centres)
            basis = np.linalg.svd(axis[None])[2]  # the axis, up to its sign, and two directions across

            def off(tilt: np.ndarray, basis: np.ndarray = basis, label: np.ndarray = label) -> np.ndarray:
                return _circles(basis[0] + tilt @ basis[1:], centres, label)[1].ravel()

            axis = basis[0] + least_squares(off, np.zeros(2), loss="soft_l1", f_scale=OFF).x @ basis[1:]
            axis /= np.linalg.norm(axis)
        axis *= np.sign(axis @ _up(poses, axis).sum(0)) or 1.0
        point, offs, sizes = _circles(axis, centres, label)
        height = float(where_they_meet(centres, poses[:, :3, 2]) @ axis)  # of the object, wherever the origin is
        sizes = tuple((high - height, wide) for high, wide in sizes)
        residual = float(np.sqrt(np.square(offs).sum() / len(offs)))
        found.append((Round(_vector(axis), _vector(point + height * axis), sizes), residual))
    return min(found, key=lambda circles: circles[1])


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


def _circles(
    axis: np.ndarray, centres: np.ndarray, label: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[tuple[float, float], ...]]:
    """A point on the axis; by how much centres are off in height and radius, (V, 2) over the mean radius; sizes of the circles.

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
    of_circles = np.stack([height, radius], 1)
    means = member.T @ of_circles / member.sum(0)[:, None]
    sizes = tuple((float(high), float(wide)) for high, wide in means)
    return middle @ across, (of_circles - member @ means) / radius.mean(), sizes
