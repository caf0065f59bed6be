"""The reader of the native folder: every refusal, each on a copy of the scene `tiny` that is broken in one place."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from broken_folder import edit_json, refused
from PIL import Image

from ia_bench.readers.contract import check_scene
from ia_bench.readers.native import NativeReader
from ia_bench.scenes.exr import read_exr, write_exr
from ia_bench.scenes.scene import Scene, View

TRUTH_FIELDS = ("albedo", "roughness", "specular", "normal", "depth")
TRAIN = "transforms_train.json"
IMAGE = "images/train/0003.exr"  # frame 3


def edit_frame(folder: Path, change: Callable[[dict[str, Any]], None], split: str = "train") -> None:
    edit_json(folder / f"transforms_{split}.json", lambda content: change(content["frames"][3]))


def edit_image(path: Path, change: Callable[[np.ndarray], None]) -> None:
    image = read_exr(path, 4)
    change(image)
    write_exr(path, image)


def write_unchecked(path: Path, image: np.ndarray) -> None:
    """What write_exr refuses: NaN and Inf."""
    channels = {name: image[..., i].astype(np.float16) for i, name in enumerate("RGBA"[: image.shape[-1]])}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))


def test_the_shipped_scene_is_read_whole(tiny: Scene) -> None:
    assert tiny.name == "tiny"
    (note,) = tiny.notes  # the specular truth of training views is stored lossily
    assert re.fullmatch(r"true specular shading: \d+ values below zero or beyond the object \(ringing .*\) set to 0", note)
    for view in tiny.train:
        assert view.specular.min() >= 0
        assert bool((view.specular[view.mask == 0] == 0).all())
    assert [len(views) for views in (tiny.train, tiny.test, tiny.novel)] == [16, 4, 16]
    assert sorted({view.light for view in tiny.novel}) == ["night", "studio", "sunset", "train"]
    assert {view.light for view in (*tiny.train, *tiny.test)} == {"train"}
    for view in (*tiny.train, *tiny.test, *tiny.novel):
        assert view.image.shape == (32, 32, 3)
        assert view.mask.shape == (32, 32)
        assert (view.image[view.mask == 0] == 0).all()
    assert all(getattr(view, name) is not None for view in tiny.test for name in TRUTH_FIELDS)
    assert all(view.albedo is not None and view.specular is not None for view in tiny.train)
    assert tiny.truth is not None
    assert set(tiny.truth.lights) == {"train", "studio", "sunset", "night"}
    np.testing.assert_allclose(np.linalg.norm(tiny.mesh.normals, axis=1), 1, atol=1e-3)


def test_texture_truth_is_linear(tiny: Scene, tiny_folder: Path) -> None:
    """Albedo is stored in sRGB and read back linear; roughness is stored as it is."""
    assert tiny.truth is not None
    assert tiny.truth.albedo is not None
    with Image.open(tiny_folder / "truth" / "albedo.png") as picture:
        code = int(np.asarray(picture.convert("RGB"))[70, 70, 0])
    expected = ((code / 255 + 0.055) / 1.055) ** 2.4 if code > 10 else code / 255 / 12.92
    assert tiny.truth.albedo[70, 70, 0] == pytest.approx(expected, rel=1e-5)
    with Image.open(tiny_folder / "truth" / "roughness.png") as picture:
        np.testing.assert_allclose(tiny.truth.roughness, np.asarray(picture.convert("L")) / 255, atol=1e-6)


def known_truth(views: tuple[View, ...]) -> list[str]:
    return [f"{view.name}.{name}" for view in views for name in TRUTH_FIELDS if getattr(view, name) is not None]


def test_truth_comes_only_when_asked_for(tiny: Scene, tiny_folder: Path) -> None:
    scene = NativeReader(tiny_folder).read(truth=False)
    assert scene.truth is None
    assert known_truth((*scene.train, *scene.test, *scene.novel)) == []
    assert known_truth(tiny.train) != []  # so the list above can be non-empty


def test_training_gets_nothing_but_its_images_masks_and_cameras(tiny: Scene) -> None:
    blind = tiny.blind()
    assert blind.notes == ()
    assert (blind.truth, blind.test, blind.novel) == (None, (), ())
    assert known_truth(blind.train) == []
    assert {field.name for field in fields(View)} == {*TRUTH_FIELDS, "name", "camera", "image", "mask", "light", "valid"}
    assert [view.name for view in blind.train] == [view.name for view in tiny.train]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(blind.train, tiny.train, strict=True))


def test_without_truth_its_files_are_not_even_opened(tiny_copy: Path) -> None:
    for path in (*(tiny_copy / "truth").rglob("*.*"), *(tiny_copy / "lights").iterdir()):
        path.unlink()
    assert len(NativeReader(tiny_copy).read(truth=False).train) == 16
    refused(tiny_copy, r"albedo_path: truth/train/albedo/0000\.exr: no such file", truth=True)


# ---------------------------------------------------------------- scene.json and the transforms
def test_refuses_a_missing_folder(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "nowhere: no such scene folder")


@pytest.mark.parametrize("name", ["scene.json", TRAIN])
def test_refuses_a_missing_part(tiny_copy: Path, name: str) -> None:
    (tiny_copy / name).unlink()
    refused(tiny_copy, re.escape(name))


def test_a_mesh_is_optional(tiny_copy: Path) -> None:
    (tiny_copy / "mesh.ply").unlink()
    scene = check_scene(NativeReader(tiny_copy).read(truth=False), truth=False)
    assert scene.mesh is None
    assert "no mesh.ply in the scene's folder" in scene.notes


def test_test_and_novel_views_are_optional(tiny_copy: Path) -> None:
    for split in ("test", "novel"):
        (tiny_copy / f"transforms_{split}.json").unlink()
    edit_json(tiny_copy / "scene.json", lambda content: content.update(splits={"train": 16}))
    scene = NativeReader(tiny_copy).read(truth=False)
    assert (len(scene.train), scene.test, scene.novel) == (16, (), ())


def test_refuses_a_scene_without_training_views(tiny_copy: Path) -> None:
    edit_json(tiny_copy / TRAIN, lambda content: content.update(frames=[]))
    refused(tiny_copy, TRAIN, "at least one training view")


@pytest.mark.parametrize("name", ["scene.json", TRAIN])
@pytest.mark.parametrize(("text", "found"), [("{", "not valid JSON"), ("[1]", "expected a JSON object, found list")])
def test_refuses_what_is_no_json_object(tiny_copy: Path, name: str, text: str, found: str) -> None:
    (tiny_copy / name).write_text(text)
    refused(tiny_copy, re.escape(name), found)


@pytest.mark.parametrize(
    ("key", "value"),
    [("color_space", "srgb"), ("color_space", None), ("up", "y"), ("lights", [1]), ("truth_textures", 3), ("metallic", "yes"),
     ("schema", 99), ("schema", "1"), ("splits", 3), ("splits", {"test": 5}), ("splits", {"validation": 4})],
)  # fmt: skip
def test_refuses_another_description(tiny_copy: Path, key: str, value: object) -> None:
    edit_json(tiny_copy / "scene.json", lambda content: content.update({key: value}))
    refused(tiny_copy, r"scene\.json", f"{key}: expected", truth=True)


@pytest.mark.parametrize("frames", [None, {}, "frames", [3]])
def test_refuses_frames_that_are_no_list_of_objects(tiny_copy: Path, frames: object) -> None:
    edit_json(tiny_copy / TRAIN, lambda content: content.update(frames=frames))
    refused(tiny_copy, TRAIN, "frames", "expected")


@pytest.mark.parametrize("value", [None, 7])
def test_refuses_a_frame_without_its_file_path(tiny_copy: Path, value: object) -> None:
    edit_frame(tiny_copy, lambda frame: frame.update(file_path=value) if value else frame.pop("file_path"))
    refused(tiny_copy, TRAIN, r"frames\[3\]", "file_path")


def test_refuses_the_same_image_twice(tiny_copy: Path) -> None:
    edit_frame(tiny_copy, lambda frame: frame.update(file_path="images/train/../train/0002.exr"))
    edit_json(tiny_copy / TRAIN, lambda content: content["frames"].append(content["frames"][5]))
    refused(tiny_copy, TRAIN, r"frames\[16\]", "every image once, found images/train/0005.exr again")


# ---------------------------------------------------------------- images
def test_refuses_a_missing_image(tiny_copy: Path) -> None:
    (tiny_copy / IMAGE).unlink()
    refused(tiny_copy, re.escape(IMAGE), "no such file")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_refuses_a_pixel_that_is_not_finite(tiny_copy: Path, bad: float) -> None:
    image = read_exr(tiny_copy / IMAGE, 4)
    image[5, 7, 1] = bad
    write_unchecked(tiny_copy / IMAGE, image)
    refused(tiny_copy, re.escape(IMAGE), "1 pixel.* NaN or Inf", "row 5, column 7")


def test_refuses_an_image_of_another_size_than_declared(tiny_copy: Path) -> None:
    write_exr(tiny_copy / IMAGE, read_exr(tiny_copy / IMAGE, 4)[:, :31])
    refused(tiny_copy, re.escape(IMAGE), "expected w = 32, found 31")


def test_images_of_two_sizes_are_read_as_they_are(tiny_copy: Path) -> None:
    edit_json(tiny_copy / TRAIN, lambda content: [content.pop(key) for key in ("w", "h")])
    write_exr(tiny_copy / IMAGE, read_exr(tiny_copy / IMAGE, 4)[:31])
    shapes = {view.name: view.mask.shape for view in check_scene(NativeReader(tiny_copy).read(truth=False), truth=False).train}
    assert shapes.pop("0003") == (31, 32)
    assert set(shapes.values()) == {(32, 32)}


def test_refuses_an_image_without_alpha(tiny_copy: Path) -> None:
    write_exr(tiny_copy / IMAGE, read_exr(tiny_copy / IMAGE, 4)[..., :3])
    refused(tiny_copy, re.escape(IMAGE), "expected channels R, G, B, A, found B, G, R")


def test_refuses_a_mask_without_a_pixel(tiny_copy: Path) -> None:
    edit_image(tiny_copy / IMAGE, lambda image: image.fill(0))
    refused(tiny_copy, "train view 0003: mask: expected a pixel above 0.5, found none")


def test_refuses_alpha_above_one(tiny_copy: Path) -> None:
    edit_image(tiny_copy / IMAGE, lambda image: np.multiply(image, 255, out=image))
    refused(tiny_copy, re.escape(IMAGE), r"alpha.*\[0, 1\].*255")


def test_refuses_negative_radiance(tiny_copy: Path) -> None:
    edit_image(tiny_copy / IMAGE, lambda image: image.__setitem__((9, 9, 0), -0.25))
    refused(tiny_copy, re.escape(IMAGE), "negative value -0.25")


def test_refuses_an_ldr_image(tiny_copy: Path) -> None:
    Image.new("RGBA", (32, 32), "red").save(tiny_copy / "images" / "train" / "0003.png")
    edit_frame(tiny_copy, lambda frame: frame.update(file_path="images/train/0003.png"))
    refused(tiny_copy, r"0003\.png", "expected a linear OpenEXR image")


def test_refuses_an_ldr_image_named_like_a_linear_one(tiny_copy: Path) -> None:
    Image.new("RGBA", (32, 32), "red").save(tiny_copy / IMAGE, format="png")
    refused(tiny_copy, re.escape(IMAGE), "not a readable OpenEXR file")


def test_refuses_truth_of_another_size(tiny_copy: Path) -> None:
    path = tiny_copy / "truth" / "test" / "depth" / "0003.exr"
    write_exr(path, read_exr(path, 1)[:16, :16])
    refused(tiny_copy, r"depth/0003\.exr", "expected 32 x 32", "found 16 x 16", truth=True)


def test_refuses_truth_with_nan(tiny_copy: Path) -> None:
    image = read_exr(tiny_copy / "lights" / "night.exr", 3)
    image[0, 0, 0] = np.nan
    write_unchecked(tiny_copy / "lights" / "night.exr", image)
    refused(tiny_copy, r"night\.exr", "NaN", truth=True)


@pytest.mark.parametrize("name", ["albedo", "roughness"])
def test_refuses_a_missing_truth_texture(tiny_copy: Path, name: str) -> None:
    (tiny_copy / "truth" / f"{name}.png").unlink()
    refused(tiny_copy, rf"{name}\.png: no such file", truth=True)


# ---------------------------------------------------------------- cameras
def spoil(rotation: str) -> Callable[[dict[str, Any]], None]:
    def change(frame: dict[str, Any]) -> None:
        matrix = np.array(frame["transform_matrix"])
        if rotation == "scaled":
            matrix[:3, :3] *= 1.01
        elif rotation == "mirrored":
            matrix[:3, 0] *= -1
        elif rotation == "sheared":
            matrix[:3, 0] += 0.1 * matrix[:3, 1]
        elif rotation == "transposed":  # a file written column by column: its rotation is still one
            matrix = matrix.T
        elif rotation == "3 x 4":
            matrix = matrix[:3]
        frame["transform_matrix"] = matrix.tolist()
        if rotation == "missing":
            del frame["transform_matrix"]
        if rotation == "ragged":
            frame["transform_matrix"][1].pop()
        if rotation == "text":
            frame["transform_matrix"][1][1] = "one"
        if rotation == "beyond":
            frame["transform_matrix"][1][1] = 10**300

    return change


@pytest.mark.parametrize(
    "rotation", ["scaled", "mirrored", "sheared", "transposed", "3 x 4", "missing", "ragged", "text", "beyond"]
)
def test_refuses_a_matrix_that_is_no_rotation(tiny_copy: Path, rotation: str) -> None:
    edit_frame(tiny_copy, spoil(rotation))
    refused(tiny_copy, TRAIN, r"frames\[3\]", "transform_matrix: expected")


@pytest.mark.parametrize(
    ("key", "value"),
    [("camera_angle_x", 0.0), ("camera_angle_x", 4.0), ("camera_angle_x", "wide"), ("fl_x", -3.0), ("fl_x", None),
     ("cx", "middle"), ("cy", True), ("w", "32 px"), ("h", None)],
)  # fmt: skip
def test_refuses_impossible_intrinsics(tiny_copy: Path, key: str, value: object) -> None:
    edit_json(tiny_copy / TRAIN, lambda content: content.update({key: value}))
    refused(tiny_copy, TRAIN, r"frames\[0\]", f"{key}.*expected|focal length: expected")


def test_refuses_a_camera_without_focal_length(tiny_copy: Path) -> None:
    edit_json(tiny_copy / TRAIN, lambda content: content.pop("camera_angle_x"))
    refused(tiny_copy, TRAIN, r"frames\[0\]", "camera_angle_x or fl_x, found neither")


def test_intrinsics_of_the_file_and_of_a_frame(tiny_copy: Path) -> None:
    """fl_x in pixels means the same as camera_angle_x; a frame's own value wins over the file's."""
    before = NativeReader(tiny_copy).read(truth=False).train[3].camera
    assert before.centre == (16, 16)
    assert before.focal[0] == pytest.approx(16 / np.tan(0.5 * 0.6632251157578453))
    edit_frame(tiny_copy, lambda frame: frame.update(fl_x=2 * before.focal[0], cx=10.5))
    scene = NativeReader(tiny_copy).read(truth=False)
    assert scene.train[3].camera.focal == pytest.approx((2 * before.focal[0],) * 2)
    assert scene.train[3].camera.centre == (10.5, 16)
    assert scene.train[2].camera.focal == pytest.approx(before.focal)
