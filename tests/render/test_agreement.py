"""Mesh and masks: how far they agree, and what is said of the mistakes that others' conventions lead to."""

from dataclasses import replace

import numpy as np
import pytest

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.render.agreement import GOOD, MISTAKES, check_agreement
from ia_bench.scenes.scene import Scene, View


def with_cameras(scene: Scene, matrices: list[np.ndarray]) -> Scene:
    views = [replace(v, camera=replace(v.camera, to_world=m)) for v, m in zip(scene.train, matrices, strict=True)]
    return replace(scene, train=tuple(views))


def test_a_scene_in_our_conventions_agrees_also_with_pixels_of_which_nothing_is_known(tiny: Scene) -> None:
    notes: list[str] = []
    assert check_agreement(tiny, notes.append) > 0.97
    assert notes == ["mesh and masks: intersection over union 0.98 over 8 training views"]
    # an object of 21 pixels loses a third of its area with a margin of two
    hidden = captured(tiny, CaptureSettings(margin=2), lambda line: None)
    assert check_agreement(hidden, lambda line: None) > 0.97


def test_photographs_may_be_strips(tiny: Scene) -> None:
    """Two rows of pixels through the middle of the object, and a hundred times as much beside it, of which nothing is known."""
    row = tiny.train[0].mask.shape[0] // 2

    def strip(view: View) -> View:
        middle = row - 1, row + 1
        cut = {name: getattr(view, name)[slice(*middle)] for name in ("image", "mask")}
        camera = replace(view.camera, centre=(view.camera.centre[0], view.camera.centre[1] - middle[0]), height=2)
        return View(view.name, camera, **cut).padded(2, 100 * view.camera.width)

    assert check_agreement(replace(tiny, train=tuple(map(strip, tiny.train))), lambda line: None) > 0.9


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_convention_of_others_is_named(tiny: Scene, mistake: str) -> None:
    """Cameras that the named change would mend; the changes that are not their own inverse are undone by solving."""
    identity = np.eye(4)
    matrices = [view.camera.to_world for view in tiny.train]
    mend = MISTAKES[mistake]
    if "world-to-camera" in mistake:
        wrong = [np.linalg.inv(matrix @ np.linalg.inv(mend(identity))) for matrix in matrices]
    else:
        at_identity = mend(identity)  # multiplied from one side or the other
        left = np.allclose(mend(matrices[0]), at_identity @ matrices[0])
        wrong = [np.linalg.inv(at_identity) @ m if left else m @ np.linalg.inv(at_identity) for m in matrices]
    np.testing.assert_allclose(mend(wrong[0]), matrices[0], atol=1e-6)
    said: list[str] = []
    try:
        check_agreement(with_cameras(tiny, wrong), said.append)  # a round object looks alike from another side: a warning
    except InputError as error:
        said.append(str(error))
    assert said[-1].endswith(f"with {mistake} it would be 0.98")


def test_a_mesh_of_another_size_is_warned_of(tiny: Scene) -> None:
    notes: list[str] = []
    found = check_agreement(replace(tiny, mesh=replace(tiny.mesh, vertices=0.9 * tiny.mesh.vertices)), notes.append)
    assert 0.6 < found < GOOD
    assert notes[0].startswith("warning: ")
    assert f"found intersection over union {found:.2f} over 8 training views; transform_matrix has to be" in notes[0]
