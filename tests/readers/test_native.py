"""The reader of the native folder: what it reads; what it refuses is in test_hostile.py. And lights that several scenes share."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from spoils import edited

from ia_bench.capture.settings import CaptureSettings
from ia_bench.capture.shapes import with_geometry
from ia_bench.checks.finding import difference
from ia_bench.common.errors import InputError
from ia_bench.readers.contract import check_scene
from ia_bench.readers.native import NativeReader
from ia_bench.readers.writers.frames import write_native
from ia_bench.scenes.exr import read_exr, write_exr
from ia_bench.scenes.scene import Scene

TRAIN = "transforms_train.json"
SHIPPED = Path(__file__).parents[2] / "datasets" / "scenes"


def refused(folder: Path, *parts: str) -> None:
    """The scene is refused in one line that holds all of ``parts`` (regular expressions)."""
    with pytest.raises(InputError) as caught:
        check_scene(NativeReader(folder).read(truth=True), truth=True)
    for part in parts:
        assert re.search(part, str(caught.value)), f"{part!r} is not in {caught.value}"


def test_the_shipped_scene_is_read_whole(tiny: Scene) -> None:
    assert tiny.name == "tiny"
    (note,) = tiny.notes  # the specular truth of training views is stored lossily
    assert re.fullmatch(r"true specular shading: \d+ values below zero or beyond the object \(ringing .*\) set to 0", note)
    for view in tiny.train:
        assert view.specular.min() >= 0
        assert bool((view.specular[view.mask == 0] == 0).all())
    assert [len(views) for views in (tiny.train, tiny.test, tiny.novel)] == [16, 4, 16]
    assert sorted({view.light for view in tiny.novel}) == ["night", "studio", "sunset", "train"]
    assert set(tiny.truth.lights) == {"train", "studio", "sunset", "night"}


def test_texture_truth_is_linear(tiny: Scene, tiny_folder: Path) -> None:
    """Albedo is stored in sRGB and read back linear; roughness is stored as it is."""
    with Image.open(tiny_folder / "truth" / "albedo.png") as picture:
        code = int(np.asarray(picture.convert("RGB"))[70, 70, 0])
    expected = ((code / 255 + 0.055) / 1.055) ** 2.4 if code > 10 else code / 255 / 12.92
    assert tiny.truth.albedo[70, 70, 0] == pytest.approx(expected, rel=1e-5)
    with Image.open(tiny_folder / "truth" / "roughness.png") as picture:
        np.testing.assert_allclose(tiny.truth.roughness, np.asarray(picture.convert("L")) / 255, atol=1e-6)


def test_without_truth_its_files_are_not_even_opened_and_a_mesh_is_optional(tiny_copy: Path) -> None:
    for path in (*(tiny_copy / "truth").rglob("*.*"), *(tiny_copy / "lights").iterdir()):
        path.unlink()
    assert len(NativeReader(tiny_copy).read(truth=False).train) == 16
    refused(tiny_copy, r"albedo_path: truth/train/albedo/0000\.exr: no such file")
    (tiny_copy / "mesh.ply").unlink()
    scene = check_scene(NativeReader(tiny_copy).read(truth=False), truth=False)
    assert scene.mesh is None
    assert "no mesh.ply in the scene's folder" in scene.notes


def test_what_is_written_is_the_same_scene(tiny: Scene, tmp_path: Path) -> None:
    write_native(tmp_path / "tiny", tiny)
    found = NativeReader(tmp_path / "tiny").read(truth=True)
    assert difference(*(replace(scene, source="", notes=(), mesh=None) for scene in (found, tiny))) is None
    for name in ("vertices", "faces", "normals", "uv"):
        np.testing.assert_allclose(getattr(found.mesh, name), getattr(tiny.mesh, name), atol=1e-6)  # normals are normalised
    write_native(tmp_path / "unsaid", replace(tiny, metallic=None))
    assert NativeReader(tmp_path / "unsaid").read(truth=False).metallic is None


def test_true_textures_stay_on_the_coordinates_that_they_belong_to(tiny: Scene, tiny_copy: Path) -> None:
    scene = NativeReader(tiny_copy, uv="xatlas").read(truth=True)
    assert not scene.mesh.same_as(tiny.mesh, uv=True)
    smoothed = with_geometry(scene, CaptureSettings(geometry="smoothed"), lambda line: None, ())
    for one in (scene, smoothed):
        assert one.truth.mesh.same_as(tiny.mesh, uv=True)
    trimesh.Trimesh(tiny.mesh.vertices, tiny.mesh.faces, process=False).export(tiny_copy / "mesh.ply")
    without = NativeReader(tiny_copy, uv="xatlas").read(truth=True)
    assert "true textures are left out: mesh.ply has no coordinates for them" in without.notes
    assert (without.truth.albedo, set(without.truth.lights)) == (None, set(tiny.truth.lights))


def test_training_photographs_are_held_out_in_no_split(tiny_copy: Path) -> None:
    first = json.loads((tiny_copy / "transforms_train.json").read_text())["frames"][0]["file_path"]
    for split in ("test", "novel"):
        path = tiny_copy / f"transforms_{split}.json"
        content = json.loads(before := path.read_text())
        content["frames"][0]["file_path"] = f"./{first}"
        path.write_text(json.dumps(content))
        refused(tiny_copy, path.name, r"frames\[0\]: file_path: expected every photograph once", "transforms_train.json")
        path.write_text(before)


def test_a_split_that_leads_nowhere_and_a_lens_are_refused(tiny_copy: Path) -> None:
    """Such as a link whose content has not been fetched; our photographs are those of pinholes."""
    (tiny_copy / "transforms_test.json").unlink()
    (tiny_copy / "transforms_test.json").symlink_to("nowhere")
    with pytest.raises(InputError, match=r"transforms_test\.json"):
        NativeReader(tiny_copy).read(truth=False)
    (tiny_copy / "transforms_test.json").unlink()
    edited(TRAIN, lambda content: content["frames"][3].update(k1=0.1))(tiny_copy)
    with pytest.raises(InputError, match=r"frames\[3\]: expected a pinhole camera without distortion"):
        NativeReader(tiny_copy).read(truth=False)


def test_intrinsics_of_the_file_and_of_a_frame(tiny_copy: Path) -> None:
    """fl_x in pixels means the same as camera_angle_x; a frame's own value wins over the file's."""
    before = NativeReader(tiny_copy).read(truth=False).train[3].camera
    assert before.centre == (16, 16)
    assert before.focal[0] == pytest.approx(16 / np.tan(0.5 * 0.6632251157578453))
    edited(TRAIN, lambda content: content["frames"][3].update(fl_x=2 * before.focal[0], cx=10.5))(tiny_copy)
    scene = NativeReader(tiny_copy).read(truth=False)
    assert scene.train[3].camera.focal == pytest.approx((2 * before.focal[0],) * 2)
    assert scene.train[3].camera.centre == (10.5, 16)
    assert scene.train[2].camera.focal == pytest.approx(before.focal)


# ---------------------------------------------------------------- lights that several scenes share
@pytest.fixture
def sharing(tiny_copy: Path) -> Path:
    """A copy of ``tiny`` below a folder of scenes, whose light ``night`` lies in the folder of shared ones."""
    (tiny_copy.parent / "scenes").mkdir()
    folder = tiny_copy.rename(tiny_copy.parent / "scenes" / "tiny")
    shared = folder.parents[1] / "lights" / "any.exr"
    shared.parent.mkdir()
    (folder / "lights" / "night.exr").rename(shared)
    told = {"shared": "any.exr", "sha256": hashlib.sha256(shared.read_bytes()).hexdigest()}
    edited("scene.json", lambda content: content["lights"].update(night=told))(folder)
    return folder


def test_a_shared_light_is_read_from_beside_the_scenes_where_it_is_the_one_of_the_scene(tiny: Scene, sharing: Path) -> None:
    scene = NativeReader(sharing).read(truth=True)
    np.testing.assert_array_equal(scene.truth.lights["night"], tiny.truth.lights["night"])
    path = sharing.parents[1] / "lights" / "any.exr"
    write_exr(path, 2 * read_exr(path, 3))
    refused(sharing, r"any\.exr: expected the light whose SHA-256 .*scene\.json: lights\.night\.sha256 tells")
    path.unlink()
    refused(sharing, r"scene\.json: lights\.night\.shared: in .*lights: any\.exr: no such file")


@pytest.mark.parametrize("name", ["../scenes/tiny/lights/sunset.exr", "/dev/null", 3])
def test_a_shared_light_lies_in_the_folder_of_lights(sharing: Path, name: object) -> None:
    edited("scene.json", lambda content: content["lights"]["night"].update(shared=name))(sharing)
    refused(sharing, r"scene\.json: lights\.night\.shared", "expected")


@pytest.mark.parametrize("name", ["hat", "ship", "console", "figurine"])
def test_the_shipped_scenes_have_their_lights(name: str) -> None:
    lights = NativeReader(SHIPPED / name).read(truth=True).truth.lights
    assert {light: radiance.shape for light, radiance in lights.items()} == dict.fromkeys(
        ("train", "studio", "sunset", "night"), (256, 512, 3)
    )
