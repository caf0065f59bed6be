"""The camera's convention, from its words alone: the mesh of `tiny`, projected and filled, is Cycles' alpha.

What a camera projects, where its rays lead and what a smaller one of it sees are compared with that formula.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.draw import polygon

from ia_bench.geometry.hull import carving_mask
from ia_bench.render.gbuffer import primary_rays
from ia_bench.scenes.images import display, straight
from ia_bench.scenes.scene import Camera, Scene, View, of_one_size

FINE = 8  # sub-pixels along a side


def projected(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column, row and depth of points, after the words of the class."""
    local = (points - camera.to_world[:3, 3]) @ np.linalg.inv(camera.to_world[:3, :3]).T
    column = camera.centre[0] + camera.focal[0] * local[:, 0] / -local[:, 2]
    return column, camera.centre[1] - camera.focal[1] * local[:, 1] / -local[:, 2], -local[:, 2]


def filled_coverage(view: View, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Coverage (H, W) of the projected triangles: x right, y up, looking along -z; row 0 on top."""
    camera = view.camera
    column, row, depth = projected(camera, vertices)
    assert (depth > 0).all()  # all in front of the camera
    image = np.zeros((camera.height * FINE, camera.width * FINE))
    for face in faces:  # skimage counts from pixel centres
        image[polygon(row[face] * FINE - 0.5, column[face] * FINE - 0.5, image.shape)] = 1
    return image.reshape(camera.height, FINE, camera.width, FINE).mean((1, 3))


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two soft masks."""
    return float(np.minimum(a, b).sum() / np.maximum(a, b).sum())


@pytest.mark.parametrize("index", range(4))
def test_projected_mesh_is_the_alpha_of_the_image(tiny: Scene, index: int) -> None:
    view = tiny.test[index]
    filled = filled_coverage(view, tiny.mesh.vertices, tiny.mesh.faces)
    assert overlap(filled, view.mask) > 0.99
    for wrong in (filled[::-1], filled[:, ::-1], np.roll(filled, 1, axis=0), np.roll(filled, 1, axis=1)):
        assert overlap(wrong, view.mask) < 0.99  # so the bound sees a flipped axis and a shift by one pixel


def test_projections_and_rays_are_the_inverse_of_each_other(tiny: Scene) -> None:
    camera = replace(tiny.train[3].camera, focal=(40.0, 33.0), centre=(17.5, 14.0))
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (60, 3))
    column, row, depth = camera.project(points)
    np.testing.assert_allclose((column, row, depth), projected(camera, points), rtol=1e-6)
    np.testing.assert_allclose(camera.position + depth[:, None] * camera.rays(column, row), points, atol=1e-6)
    for ours, theirs in zip(camera.project(torch.from_numpy(points).float()), (column, row, depth), strict=True):
        assert ours.dtype == torch.float32
        np.testing.assert_allclose(ours, theirs, rtol=1e-4)
    behind = camera.project(camera.position + camera.to_world[None, :3, 2])
    assert behind[2] < 0
    assert np.isfinite(behind).all()


def test_a_scaled_view_sees_the_same_in_larger_pixels(tiny: Scene) -> None:
    view = replace(tiny.test[0], valid=np.indices((32, 32))[0] != 4)
    small = view.scaled(3)
    assert small.mask.shape == (small.camera.height, small.camera.width) == (10, 10)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (9, 3))
    np.testing.assert_allclose(small.camera.project(points)[:2], np.divide(view.camera.project(points)[:2], 3), rtol=1e-12)
    np.testing.assert_allclose(small.albedo[2, 4], view.albedo[6:9, 12:15].mean((0, 1)), rtol=1e-5)
    assert (~small.valid).nonzero()[0].tolist() == [1] * 10  # a block is known where all of it is
    assert view.scaled(1) is view


def test_what_is_beyond_a_photograph_is_no_outline_in_larger_pixels(tiny: Scene) -> None:
    """An object that fills the photograph, of which a lens has left two columns unknown."""
    full = np.ones((32, 32), np.float32)
    beyond = np.indices((32, 32))[1] < 2
    view = replace(tiny.test[0], mask=np.where(beyond, 0, full), image=np.ones((32, 32, 3), np.float32) * ~beyond[..., None])
    small = replace(view, valid=~beyond).scaled(4)
    assert small.mask[:, 0].tolist() == [0.0] * 8
    assert not small.image[:, 0].any()
    np.testing.assert_array_equal(small.mask[:, 1:], 1)
    np.testing.assert_array_equal(small.valid, np.indices((8, 8))[1] > 0)
    assert (carving_mask(small) == 1).all()
    assert view.scaled(4).mask[0, 0] == 0.5, "of a photograph that is known this is the outline"


def test_what_covers_a_pixel_is_the_image_over_its_coverage() -> None:
    coverage = np.array([[0, 1, 0.5, 1e-4]], np.float32)
    image = np.array([[7, 0.25, 0.25, 1e-4]], np.float32)
    np.testing.assert_allclose(straight(image, coverage), [[0, 0.25, 0.5, 1]])
    coloured = np.repeat(image[..., None], 3, -1)
    np.testing.assert_allclose(straight(torch.from_numpy(coloured), torch.from_numpy(coverage), 1e-3)[0, 3], [0.1] * 3)
    shown = display(coloured, coverage, 2.0)[0, :, 1]
    np.testing.assert_allclose(shown, [0, 1.055 * 0.5 ** (1 / 2.4) - 0.055, 1, 1], rtol=1e-6)


def cropped(view: View, height: int, width: int) -> View:
    """The upper left part of a view, as a photograph of its own."""
    arrays = {name: array[:height, :width] for name, array in vars(view).items() if isinstance(array, np.ndarray)}
    return replace(view, camera=replace(view.camera, height=height, width=width), **arrays)


def test_what_was_seen_stays_and_the_rest_is_unknown(tiny: Scene) -> None:
    low, narrow = cropped(tiny.test[0], 25, 32), cropped(tiny.test[1], 32, 19)
    padded = of_one_size([low, narrow])
    for before, after in zip((low, narrow), padded, strict=True):
        height, width = before.mask.shape
        assert after.mask.shape == (after.camera.height, after.camera.width) == (32, 32)
        for name in ("image", "mask", "albedo", "roughness"):
            np.testing.assert_array_equal(getattr(after, name)[:height, :width], getattr(before, name))
        outside = np.ones((32, 32), bool)
        outside[:height, :width] = False
        np.testing.assert_array_equal(after.valid, ~outside)
        assert not after.mask[outside].any()
        assert not after.image[outside].any()
        rays = primary_rays(after.camera, 1)[1][:height, :width]
        np.testing.assert_array_equal(rays, primary_rays(before.camera, 1)[1])
