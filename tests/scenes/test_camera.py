"""The camera's convention, from its words alone: the mesh of `tiny`, projected and filled, is Cycles' alpha."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.draw import polygon

from ia_bench.scenes.scene import Scene, View

FINE = 8  # sub-pixels along a side


def filled_coverage(view: View, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Coverage (H, W) of the projected triangles: x right, y up, looking along -z; row 0 on top."""
    camera = view.camera
    local = (vertices - camera.to_world[:3, 3]) @ np.linalg.inv(camera.to_world[:3, :3]).T
    assert (local[:, 2] < 0).all()  # all in front of the camera
    column = camera.centre[0] + camera.focal[0] * local[:, 0] / -local[:, 2]
    row = camera.centre[1] - camera.focal[1] * local[:, 1] / -local[:, 2]
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


def test_view_and_camera_belong_together(tiny: Scene) -> None:
    """The masks tell the cameras apart."""
    filled = [filled_coverage(view, tiny.mesh.vertices, tiny.mesh.faces) for view in tiny.test]
    table = np.array([[overlap(image, view.mask) for view in tiny.test] for image in filled])
    assert (table.argmax(1) == np.arange(4)).all()
