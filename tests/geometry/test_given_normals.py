"""Normals from files: what each format holds, what is refused, and that wrong axes are told by what a bowl's outlines show."""

from collections.abc import Callable
from pathlib import Path

import bowls
import numpy as np
import pytest
from PIL import Image

from ia_bench.capture.capture import captured
from ia_bench.capture.faults import spread_over_directions
from ia_bench.capture.settings import CaptureSettings, SdfSettings
from ia_bench.capture.shapes import given_normals
from ia_bench.common.errors import InputError
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene, View

SIDE = 40
pytestmark = pytest.mark.usefixtures("no_cache")


@pytest.fixture(scope="module")
def views() -> list[View]:
    return bowls.bowl_views(10, SIDE, 6.0)


def write_png(path: Path, normals: np.ndarray) -> None:
    """By the description: 0.5 (n + 1) in 8 bits, so that nothing is grey."""
    Image.fromarray(np.round(255 * 0.5 * (normals + 1)).astype(np.uint8)).save(path.with_suffix(".png"))


def write_half_exr(path: Path, normals: np.ndarray) -> None:
    write_exr(path.with_suffix(".exr"), normals)


def write_npy(path: Path, normals: np.ndarray) -> None:
    np.save(path.with_suffix(".npy"), normals)


def folder_of(views: list[View], folder: Path, write: Callable[[Path, np.ndarray], None] = write_npy) -> Path:
    folder.mkdir()
    for view in views:
        write(folder / view.name, bowls.camera_normals(view))
    return folder


@pytest.mark.parametrize(("write", "degrees"), [(write_png, 0.5), (write_half_exr, 0.05), (write_npy, 1e-3)])
def test_each_format_is_read(views: list[View], tmp_path: Path, write: Callable[[Path, np.ndarray], None], degrees: float) -> None:
    found = given_normals(str(folder_of(views, tmp_path / "normals", write)), views)
    for view, normals in zip(views, found, strict=True):
        true = bowls.camera_normals(view)
        known = (true != 0).any(-1)
        np.testing.assert_array_equal((normals != 0).any(-1), known)
        cosine = (normals * true).sum(-1)[known]
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < max(degrees, 0.03)  # of float32 near a cosine of 1
        assert normals.dtype == np.float32


@pytest.mark.parametrize("wrong", ["OpenCV's", "inward", "the world's"])
def test_normals_that_look_away_are_refused(views: list[View], tmp_path: Path, wrong: str) -> None:
    def turned(view: View) -> np.ndarray:
        normals = bowls.camera_normals(view)
        axes = {"OpenCV's": np.diag([1, -1, -1]), "inward": -np.eye(3), "the world's": view.camera.to_world[:3, :3].T}
        return normals @ axes[wrong]

    folder = tmp_path / "normals"
    folder.mkdir()
    for view in views:
        write_png(folder / view.name, turned(view))
    with pytest.raises(InputError, match="expected normals of the camera .* look away from it"):
        given_normals(str(folder), views)


def stored(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda path: np.save(path, change(np.load(path)))


MISTAKES: dict[str, tuple[Callable[[Path], None], str]] = {
    "missing": (Path.unlink, r"expected one of 03\.png, 03\.exr, 03\.npy for training view 03, found none"),
    "two": (lambda path: path.with_suffix(".png").write_bytes(b""), r"for training view 03, found 03\.png and 03\.npy"),
    "another size": (stored(lambda n: n[1:]), r"03\.npy: expected 40 x 40 pixels like the training view.*found 40 x 39"),
    "channels first": (stored(lambda n: np.moveaxis(n, -1, 0)), r"expected \(height, width, 3\) values, or 4 with alpha, found"),
    "half as long": (stored(lambda n: 0.6 * n), "expected unit normals, found a median length of 0.60"),
    "nothing": (stored(np.zeros_like), "expected normals where the mask shows the object, found none"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_wrong_file_is_one_sentence(views: list[View], tmp_path: Path, mistake: str) -> None:
    spoil, says = MISTAKES[mistake]
    folder = folder_of(views, tmp_path / "normals")
    spoil(folder / "03.npy")
    with pytest.raises(InputError, match=says) as caught:
        given_normals(str(folder), views)
    assert "\n" not in str(caught.value)


def scene_of(views: list[View]) -> Scene:
    return Scene("bowl", "a bowl", None, tuple(views))


def test_a_capture_takes_them_by_name_and_by_content(views: list[View], tmp_path: Path) -> None:
    """Views that are left out need none; a mesh is another one with other normals, and the same one wherever they lie."""
    few = list(spread_over_directions(tuple(views), 6))
    one, same = folder_of(few, tmp_path / "one"), folder_of(few, tmp_path / "same")
    other = folder_of(few, tmp_path / "other")
    np.save(other / f"{few[0].name}.npy", np.full((SIDE, SIDE, 3), np.float32([0, 0, 1])))
    notes: list[str] = []

    def mesh_with(normals: Path | None) -> np.ndarray:
        sdf = SdfSettings(cells=32, steps=3, normals=str(normals) if normals else "none")
        settings = CaptureSettings(views=6, geometry="sdf", triangles=1000, sdf=sdf)
        return captured(scene_of(views), settings, notes.append).expect_mesh().vertices

    first = mesh_with(one)
    np.testing.assert_array_equal(first, mesh_with(same))
    assert len(notes) == 1  # the second one is from the cache
    for another in (mesh_with(other), mesh_with(None)):
        assert another.shape != first.shape or not np.array_equal(another, first)
    assert len(notes) == 3
