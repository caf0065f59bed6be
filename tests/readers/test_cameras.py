"""Cameras and lenses of other conventions against what they must see, by each format's own formula."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ia_bench.common.errors import InputError
from ia_bench.geometry.hull import carving_mask
from ia_bench.readers.cameras import (
    camera,
    expect_looking_at_object,
    from_projection,
    from_world_to_camera,
    share_away,
)
from ia_bench.readers.lenses import Lens, lens, undistorted
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.scenes.scene import Camera, Scene, View

# ---------------------------------------------------------------- cameras of other conventions against what they must see
# A point projected by the format's own formula and by ours.
POINT = np.array([0.3, -0.2, 0.4])
K = np.array([[61.0, 0, 30.3], [0, 59.0, 17.9], [0, 0, 1]])
ROTATION = Rotation.from_euler("xyz", [0.4, -2.0, 1.1]).as_matrix()
SHIFT = np.array([0.1, 0.2, 3.0])


@pytest.mark.parametrize("factor", [1.0, -1.0, 37.0, -0.02])
def test_a_projection_of_any_scale_and_sign(factor: float) -> None:
    camera = from_projection("P", factor * K @ np.c_[ROTATION, SHIFT], 64, 36)
    x, y, z = K @ (ROTATION @ POINT + SHIFT)
    np.testing.assert_allclose(camera.project(POINT[None]), [[x / z + 0.5], [y / z + 0.5], [z]], atol=1e-9)
    np.testing.assert_allclose(camera.focal, (61, 59))
    assert np.linalg.det(camera.to_world[:3, :3]) == pytest.approx(1)


def test_a_world_to_camera_matrix_of_opencv() -> None:
    to_world = from_world_to_camera(np.vstack([np.c_[ROTATION, SHIFT], [0, 0, 0, 1]]))
    x, y, z = ROTATION @ POINT + SHIFT
    np.testing.assert_allclose(np.linalg.inv(to_world)[:3] @ [*POINT, 1], [x, -y, -z], atol=1e-12)


def test_models_by_name_and_what_is_no_projection() -> None:
    with pytest.raises(InputError, match="P: expected a projection of full rank"):
        from_projection("P", np.zeros((3, 4)), 1, 1)
    skewed = K + [[0, 5.0, 0], [0, 0, 0], [0, 0, 0]]
    with pytest.raises(InputError, match="expected rectangular pixels, found a skew of 5 pixels"):
        from_projection("P", skewed @ np.c_[ROTATION, SHIFT], 1, 1)
    assert lens("it", {"camera_model": "OPENCV", "k1": 0.1, "p2": 0.2}) == Lens(k1=0.1, p2=0.2)
    assert lens("it", {"distortion_params": [0.1, 0, 0, 0, 0.3, 0.2], "k1": 7.0}) == Lens(k1=0.1, p1=0.3, p2=0.2)
    with pytest.raises(InputError, match=r"it: distortion_params: expected k1, .* as 6 finite numbers, found \[0\.1, 0\.2\]"):
        lens("it", {"distortion_params": [0.1, 0.2]})
    assert lens("it", {}) == Lens()
    with pytest.raises(InputError, match=r"it: camera_model: expected one of PINHOLE, .*, found 'EQUIRECTANGULAR'"):
        lens("it", {"camera_model": "EQUIRECTANGULAR"})


def test_a_last_row_that_is_rounded_is_exact_again() -> None:
    rounded = np.vstack([np.c_[ROTATION, SHIFT], [1e-17, 0, 0, 1 - 1e-12]])
    frame = {"fl_x": 8.0, "transform_matrix": rounded.tolist()}
    assert camera("it", frame, (8, 8)).to_world[3].tolist() == [0, 0, 0, 1]


def test_where_cameras_look(tiny: Scene) -> None:
    assert share_away(tiny.train) == 0
    assert share_away(tiny.train[:1] * 5) == 0  # parallel rays meet nowhere
    empty = replace(tiny.train[0], mask=0 * tiny.train[0].mask)
    assert share_away([empty, *tiny.train]) == share_away([empty]) == 0
    flip = np.diag([1.0, -1, -1, 1])
    wrong = [replace(view, camera=replace(view.camera, to_world=view.camera.to_world @ flip)) for view in tiny.train]
    with pytest.raises(InputError, match="it: expected cameras that look at the object .* 100% look away from it"):
        expect_looking_at_object("it", wrong)


# ---------------------------------------------------------------- undistortion against the forward model
# A spot where the lens throws a point comes to lie where a pinhole sees the point.
FOCAL, CENTRE = (50.0, 47.0), (31.3, 22.8)
GLASS = Lens(k1=-0.2, k2=0.05, p1=0.01, p2=-0.02)


def spot(column: float, row: float) -> View:
    """A photograph (48 x 64) of one soft spot, all of it object."""
    place = np.mgrid[:48, :64] + 0.5
    image = np.exp(-0.5 * ((place[0] - row) ** 2 + (place[1] - column) ** 2) / 2**2)[..., None] * np.ones(3)
    camera = Camera(np.eye(4), FOCAL, CENTRE, 64, 48)
    return View("spot", camera, image.astype(np.float32), np.ones((48, 64), np.float32))


def by_hand(x: float, y: float) -> tuple[float, float]:
    """OpenCV's documentation, calib3d: distortion with (k1, k2, p1, p2)."""
    k1, k2, p1, p2 = -0.2, 0.05, 0.01, -0.02
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.3, 0.1), (-0.35, 0.25), (0.2, -0.3)])
def test_a_spot_comes_to_lie_where_a_pinhole_sees_it(x: float, y: float) -> None:
    u, v = by_hand(x, y)
    found = undistorted("it", spot(CENTRE[0] + FOCAL[0] * u, CENTRE[1] + FOCAL[1] * v), GLASS).image[..., 0]
    rows, columns = np.mgrid[:48, :64] + 0.5
    centroid = (columns * found).sum() / found.sum(), (rows * found).sum() / found.sum()
    # The spot is stretched unevenly, which moves its centroid by a few hundredths of a pixel.
    np.testing.assert_allclose(centroid, (CENTRE[0] + FOCAL[0] * x, CENTRE[1] + FOCAL[1] * y), atol=0.12)


def test_what_no_photograph_shows_is_masked_and_unknown() -> None:
    """x (1 + k1 r^2) by hand: where it leaves the picture's edges, nobody knows whether there is object."""
    glass, (rows, columns) = Lens(k1=0.5), np.mgrid[:48, :64] + 0.5
    x, y = (columns - CENTRE[0]) / FOCAL[0], (rows - CENTRE[1]) / FOCAL[1]
    stretch = 1 + 0.5 * (x**2 + y**2)
    column, row = x * stretch * FOCAL[0] + CENTRE[0], y * stretch * FOCAL[1] + CENTRE[1]
    within = (column >= 0) & (column <= 64) & (row >= 0) & (row <= 48)
    assert 0.6 < within.mean() < 0.9
    view = undistorted("it", spot(30, 20), glass)
    assert np.array_equal(view.mask, within)
    assert np.array_equal(view.valid, within)
    assert (view.image[~within] == 0).all()
    assert (carving_mask(view) == 1).all()  # a photograph full of object carves nothing
    known = np.ones((48, 64), bool)
    known[20, 30] = False
    mended = undistorted("it", replace(spot(30, 20), valid=known), glass).valid
    assert not mended[~within].any()
    assert 1 <= (within & ~mended).sum() <= 4


def test_a_held_out_pixel_that_nobody_has_seen_is_not_scored(tmp_path: Path) -> None:
    """Others are, the saturated ones among them: scores clip both images."""
    saturated = np.ones((48, 64), bool)
    saturated[20, 30] = False
    view = undistorted("it", replace(spot(30, 20), valid=saturated), Lens(k1=0.5))
    whole = replace(spot(30, 20), valid=saturated)
    scene = NerfstudioReader(tmp_path).scene(train=[view], test=[view], novel=[whole])
    assert np.array_equal(scene.train[0].valid, view.valid)
    assert np.array_equal(scene.test[0].valid, view.mask > 0)
    assert scene.novel[0].valid is None


@pytest.mark.parametrize(
    ("width", "height", "k1"),
    [
        (640, 360, -0.4),
        (360, 640, -0.4),  # folds along its columns alone
        (500, 500, -0.38),  # its slopes along rows and columns stay above 0, that along its diagonals does not
        (64, 48, -40.0),
        (64, 48, -1e6),  # all of the picture is turned by half, so its area is positive
    ],
)
def test_a_lens_under_which_the_picture_folds_is_refused(width: int, height: int, k1: float) -> None:
    camera = Camera(np.eye(4), (350.0, 350.0), (width / 2, height / 2), width, height)
    view = View("it", camera, np.ones((height, width, 3), np.float32), np.ones((height, width), np.float32))
    undistorted("it", view, Lens(k1=-0.05))
    with pytest.raises(InputError, match="found one under which the picture folds over"):
        undistorted("it", view, Lens(k1=k1))
