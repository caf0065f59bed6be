"""Cameras of other conventions against what they must see: a point projected by the format's own formula and by ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ia_bench.common.errors import InputError
from ia_bench.readers.base import evenly
from ia_bench.readers.cameras import expect_looking_at_object, from_projection, from_world_to_camera, looking
from ia_bench.scenes.scene import Camera, Scene

POINT = np.array([0.3, -0.2, 0.4])
K = np.array([[61.0, 0, 30.3], [0, 59.0, 17.9], [0, 0, 1]])
ROTATION = Rotation.from_euler("xyz", [0.4, -2.0, 1.1]).as_matrix()
SHIFT = np.array([0.1, 0.2, 3.0])


def seen(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Where our camera sees a point: column and row, from the corner of the first pixel."""
    x, y, z = np.linalg.inv(camera.to_world)[:3] @ [*point, 1]
    return np.array([camera.centre[0] + camera.focal[0] * x / -z, camera.centre[1] + camera.focal[1] * y / z])


@pytest.mark.parametrize("factor", [1.0, -1.0, 37.0, -0.02])
def test_a_projection_of_any_scale_and_sign(factor: float) -> None:
    camera = from_projection("P", factor * K @ np.c_[ROTATION, SHIFT], 64, 36)
    x, y, z = K @ (ROTATION @ POINT + SHIFT)
    np.testing.assert_allclose(seen(camera, POINT), [x / z + 0.5, y / z + 0.5], atol=1e-9)
    np.testing.assert_allclose(camera.focal, (61, 59))
    assert np.linalg.det(camera.to_world[:3, :3]) == pytest.approx(1)


def test_a_world_to_camera_matrix_of_opencv() -> None:
    to_world = from_world_to_camera(np.vstack([np.c_[ROTATION, SHIFT], [0, 0, 0, 1]]))
    x, y, z = ROTATION @ POINT + SHIFT
    np.testing.assert_allclose(np.linalg.inv(to_world)[:3] @ [*POINT, 1], [x, -y, -z], atol=1e-12)


def test_what_is_no_projection() -> None:
    with pytest.raises(InputError, match=r"P: expected a projection of 3 x 4 finite numbers, found shape \(4, 4\)"):
        from_projection("P", np.eye(4), 1, 1)
    with pytest.raises(InputError, match="P: expected a projection of full rank"):
        from_projection("P", np.zeros((3, 4)), 1, 1)
    skewed = K + [[0, 5.0, 0], [0, 0, 0], [0, 0, 0]]
    with pytest.raises(InputError, match="expected rectangular pixels, found a skew of 5 pixels"):
        from_projection("P", skewed @ np.c_[ROTATION, SHIFT], 1, 1)


def test_where_cameras_look(tiny: Scene) -> None:
    assert looking(tiny.train).min() > 0.95
    assert looking(tiny.train, lambda pose: pose @ FLIPPED).max() < -0.95
    assert looking(tiny.train[:1] * 5) is None  # parallel rays meet nowhere


FLIPPED = np.diag([1.0, -1, -1, 1])


@pytest.mark.parametrize(
    ("written", "named"),
    [
        (lambda matrix: matrix @ FLIPPED, "100% look away from it; OpenCV's axes .* are exchanged$"),
        (np.linalg.inv, "look away from it; the matrices seem to be world-to-camera: their inverses"),
        (lambda matrix: np.linalg.inv(matrix @ FLIPPED), "look away from it; the matrices seem to be OpenCV's world-to-camera:"),
    ],
)
def test_the_convention_is_named_in_which_cameras_look_at_what_masks_show(
    tiny: Scene, written: Callable[[np.ndarray], np.ndarray], named: str
) -> None:
    expect_looking_at_object("it", tiny.train)
    wrong = [replace(view, camera=replace(view.camera, to_world=written(view.camera.to_world))) for view in tiny.train]
    with pytest.raises(InputError, match=named):
        expect_looking_at_object("it", wrong)


def test_cameras_that_look_away_in_every_convention_are_told_so(tiny: Scene) -> None:
    """They are turned round about themselves by another angle each, around an axis that leans as much."""
    poses = []
    for place, view in enumerate(tiny.train):
        turn = np.eye(4)
        angles = [180 + 10 * place % 70, 37 * place % 50 - 25, 70 * place]
        turn[:3, :3] = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
        poses.append(view.camera.to_world @ turn)
    wrong = [replace(v, camera=replace(v.camera, to_world=pose)) for v, pose in zip(tiny.train, poses, strict=True)]
    with pytest.raises(InputError, match="no other known convention either, so the poses or the masks are wrong"):
        expect_looking_at_object("it", wrong)


@pytest.mark.parametrize("total", [1, 2, 7, 16, 100])
def test_fewer_views_are_among_more(total: int) -> None:
    items = list(range(total))
    for count in range(1, total):
        few, more = evenly(items, count), evenly(items, count + 1)
        assert len(few) == count
        assert set(few) < set(more)
        assert few == sorted(few)
    assert evenly(items, None) == items
    assert evenly(list(range(16)), 4) == [0, 4, 8, 12]
