"""Poses and masks of a few photographs are made to agree, too: as many are doubted as leave a hull that is closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ia_bench.capture.capture import captured
from ia_bench.capture.faults import misplaced
from ia_bench.capture.settings import CaptureSettings, FaultSettings
from ia_bench.capture.views import spread
from ia_bench.common.errors import InputError
from ia_bench.geometry.consistency import consistent
from ia_bench.scenes.scene import Scene, View


def pixels_off(views: tuple[View, ...], true: tuple[View, ...], points: np.ndarray) -> float:
    """How far the cameras move points (N, 3) in their images, pixels, root mean square."""
    squares = []
    for view, exact in zip(views, true, strict=True):
        local = [(points - v.camera.to_world[:3, 3]) @ v.camera.to_world[:3, :3] for v in (view, exact)]
        one, two = (view.camera.focal[0] * each[:, :2] / each[:, 2:] for each in local)
        squares.append(float(((one - two) ** 2).sum(-1).mean()))
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize("count", [3, 5, 6, 8])
def test_wrong_poses_of_few_photographs_are_put_right(tiny: Scene, count: int) -> None:
    """What is still wrong after it is less than before, by the true cameras, which nothing that is made knows."""
    faults, notes = FaultSettings(poses=1.0), list[str]()
    true = spread(tiny.train, count)
    spoiled = tuple(replace(v, camera=camera) for v, camera in zip(true, misplaced(true, faults), strict=True))
    after = captured(tiny, CaptureSettings(views=count, faults=faults, consistency=3), notes.append).train
    points = tiny.expect_mesh().vertices[::20]
    assert pixels_off(after, true, points) < 0.9 * pixels_off(spoiled, true, points)
    assert any("a hull that tolerates 3 views is open" in note for note in notes) == (count == 8)


def test_three_of_many_photographs_are_doubted(tiny: Scene) -> None:
    after = captured(tiny, CaptureSettings(consistency=1), lambda line: None).train
    for view, expected in zip(after, consistent(tiny.train, 1, 3), strict=True):
        np.testing.assert_array_equal(view.camera.to_world, expected.camera.to_world)
        np.testing.assert_array_equal(view.mask, expected.mask)


def test_a_hull_that_stays_open_is_told_with_how_many_may_be_wrong(tiny: Scene) -> None:
    with pytest.raises(InputError, match=r"^masks: expected views from enough sides.*, found 2 views that leave it open; "):
        captured(tiny, CaptureSettings(views=2, consistency=1), lambda line: None)
    with pytest.raises(InputError, match=r"found 4 views that leave it open, 2 of which may be wrong \(capture\.tolerated\)"):
        captured(tiny, CaptureSettings(views=4, geometry="hull", tolerated=2), lambda line: None)


@pytest.mark.parametrize("settings", [CaptureSettings(geometry="hull"), CaptureSettings(consistency=1)])
def test_no_fewer_photographs_than_may_be_wrong(tiny: Scene, settings: CaptureSettings) -> None:
    asked = replace(settings, views=3, tolerated=3)
    with pytest.raises(InputError, match=r"^capture\.tolerated=3: expected fewer than the 3 photographs that are taken$"):
        captured(tiny, asked, lambda line: None)
    unread = CaptureSettings(views=3, tolerated=3)  # told of, and not refused, where nothing reads it
    assert len(captured(tiny, unread, lambda line: None).train) == 3
