"""Typical mistakes in formats with NeRF's transforms.json, and in folders of one view each."""

from __future__ import annotations

import numpy as np
from spoiled import (
    AXES,
    DEGREES,
    MESH,
    TWICE,
    Mistakes,
    bare_mask,
    bare_png,
    beside,
    black,
    both,
    broken_json,
    edit,
    farther,
    frame,
    gone,
    in_all,
    matrix,
    metadata,
    multiplied,
    opaque,
    other_axes,
    picture,
    rescaled,
    shifted,
    smaller,
    srgb_as_linear_in,
    text,
)

WHOLE, TRAIN = "transforms.json", "transforms_train.json"


def halved(to_world: np.ndarray) -> np.ndarray:
    """What InvRender does to translations."""
    return to_world * np.array([[1, 1, 1, 0.5]] * 3 + [[1, 1, 1, 1]])


VIEW_FOLDERS: Mistakes = {
    "no views": (in_all("train_*", gone), "expected folders train_000, train_001, ... with metadata.json, found none"),
    "no metadata": (gone("train_003/metadata.json"), r"train_003/metadata\.json: no such file"),
    "broken JSON": (broken_json("train_003/metadata.json"), r"train_003/metadata\.json: not valid JSON"),
    "no field of view": (
        edit("train_003/metadata.json", lambda m: m.pop("cam_angle_x")),
        "metadata.json: expected cam_angle_x, found none",
    ),
    "degrees": (edit("train_003/metadata.json", lambda m: m.update(cam_angle_x=38.0)), DEGREES),
    "12 numbers": (
        edit("train_003/metadata.json", lambda m: m.update(cam_transform_mat=",".join(m["cam_transform_mat"].split(",")[:12]))),
        "cam_transform_mat: expected 16 numbers with commas, found 12",
    ),
    "scaled": (edit("train_003/metadata.json", metadata(rescaled)), r"cam_transform_mat: expected a rotation.*det = 8"),
    "transposed": (edit("train_003/metadata.json", metadata(np.transpose)), "cam_transform_mat: expected the last row 0 0 0 1"),
    "OpenCV axes": (in_all("*/metadata.json", lambda name: edit(name, metadata(other_axes))), AXES),
    "truth of another view": (
        picture("test_001/albedo.png", shifted),
        r"albedo\.png: expected truth with the silhouette of its photograph",
    ),
    "raw normals": (
        picture("test_001/normal.png", lambda v: np.concatenate([v[..., :3] // 2, v[..., 3:]], -1)),
        "expected unit normals stored as",
    ),
}


def photos(name: str) -> Mistakes:
    """Mistakes in the photographs of a folder per view."""
    return {
        "no photograph": (gone(f"train_003/{name}"), rf"train_003/{name}: no such file"),
        "no mask": (picture(f"train_003/{name}", opaque), rf"{name}: expected a mask in its alpha.*found an opaque picture"),
        "empty mask": (picture(f"train_003/{name}", black), rf"{name}: the mask has no pixel of an object"),
        "another size": (picture(f"train_003/{name}", smaller), rf"{name}: expected 32 x 32 pixels.*found 28 x 24"),
        "multiplied twice": (in_all(f"train_*/{name}", lambda path: picture(path, multiplied)), TWICE),
    }


MISTAKES: dict[str, Mistakes] = {
    "nerfstudio": {
        "no file": (gone(WHOLE), "expected transforms.json or transforms_train.json, found neither"),
        "no frames": (edit(WHOLE, lambda c: c.pop("frames")), "frames: expected a list, found NoneType"),
        "no photograph": (
            gone("images/train_0003.png"),
            r"frames\[3\]: file_path: 'images/train_0003.png'|images/train_0003.png: no such file",
        ),
        "no mask": (
            both(gone("masks"), frame(WHOLE, lambda one: one.pop("mask_path"), every=True)),
            "expected a mask in its alpha, or in a file of its own, found an opaque picture",
        ),
        "mask not there": (gone("masks/train_0003.png"), r"frames\[3\]: mask_path: masks/train_0003.png: no such file"),
        "mask of another size": (picture("masks/train_0003.png", smaller), r"masks/train_0003.png: expected 32 x 32 pixels"),
        "another size": (picture("images/train_0003.png", smaller), r"expected 28 x 24 pixels|expected w = 32"),
        "wrong width": (edit(WHOLE, lambda c: c.update(w=64)), "expected w = 64, as .* says, found 32"),
        "focal length in a list": (edit(WHOLE, lambda c: c.update(fl_x=[50.0])), r"fl_x: expected a finite number, found \[50.0\]"),
        "a picture beyond": (
            lambda f: (f / "images/train_0003.png").write_bytes(bare_png(13000, 13000)),
            r"images/train_0003\.png: expected at most 67108864 pixels \(8192 x 8192\), found 13000 x 13000; make it smaller",
        ),
        "fisheye": (
            edit(WHOLE, lambda c: c.update(camera_model="OPENCV_FISHEYE")),
            "camera_model: expected one of.*found 'OPENCV_FISHEYE'",
        ),
        "absurd lens": (edit(WHOLE, lambda c: c.update(k1=-40.0)), "expected the distortion of a lens, found one under which"),
        "3 x 4": (frame(WHOLE, matrix(lambda m: m[:3])), r"transform_matrix: expected 4 x 4 finite numbers, found shape \(3, 4\)"),
        "mirrored": (frame(WHOLE, matrix(lambda m: m * [-1, 1, 1, 1])), "transform_matrix: expected a rotation.*det = -1"),
        "OpenCV axes": (frame(WHOLE, matrix(other_axes), every=True), AXES),
        "world-to-camera": (frame(WHOLE, matrix(np.linalg.inv), every=True), "the matrices seem to be world-to-camera: their"),
        "another scale": (frame(WHOLE, matrix(farther), every=True), MESH),
        "unknown split": (
            edit(WHOLE, lambda c: c["train_filenames"].append("no.png")),
            "train_filenames: expected file paths of frames, found 'no.png'",
        ),
        "mask of everything": (in_all("masks/*.png", bare_mask), MESH),
    },
    "blender": {
        "no file": (gone(TRAIN), "expected transforms.json or transforms_train.json, found neither"),
        "no frame": (edit(TRAIN, lambda c: c.update(frames=[])), "frames: expected at least one frame, found none"),
        "no photograph": (gone("train/r_0003.png"), r"frames\[3\]: file_path: \./train/r_0003: no such file"),
        "no mask": (picture("train/r_0003.png", opaque), r"r_0003.png: expected a mask in its alpha"),
        "no field of view": (edit(TRAIN, lambda c: c.pop("camera_angle_x")), "expected camera_angle_x or fl_x, found neither"),
        "another size": (
            picture("train/r_0003.png", smaller),
            r"expected 32 x 32 pixels like r_0000.png with the same intrinsics, found 28 x 24",
        ),
        "OpenCV axes": (frame(TRAIN, matrix(other_axes), every=True), AXES),
        "multiplied twice": (in_all("train/*.png", lambda name: picture(name, multiplied)), TWICE),
        "no picture": (text("train/r_0003.png", "no picture"), "r_0003.png: expected a picture"),
    },
    "tensoir": {**VIEW_FOLDERS, **photos("rgba_sunset_000.png")},
    "nerfactor": {
        **VIEW_FOLDERS,
        **photos("rgba.png"),
        "a light beyond": (edit("train_000/metadata.json", lambda m: m.update(envmap_inten=1e38)), "light train: expected finite"),
    },
    "synthetic4relight": {
        "no file": (gone(TRAIN), r"transforms_train\.json: no such file"),
        "no photograph": (gone("train/003_rgb.exr"), r"frames\[3\]: file_path: ./train/003_rgb.exr: no such file"),
        "no mask": (gone("train/003_mask.png"), r"frames\[3\]: file_path: ./train/003_mask.png: no such file"),
        "path with suffix": (
            frame(TRAIN, lambda one: one.update(file_path="./train/003_rgb.exr")),
            "003_rgb.exr_rgb.exr: no such file",
        ),
        "halved translations": (frame(TRAIN, matrix(halved), every=True), MESH),
        "OpenCV axes": (frame(TRAIN, matrix(other_axes), every=True), AXES),
        "sRGB as linear": (srgb_as_linear_in("train"), "warning: the linear images hold 8-bit steps from 0 to 1 only"),
        "truth of another view": (picture("test/001_albedo.png", shifted), "001_albedo.png: expected truth with the silhouette"),
        "relit in another size": (
            picture("test_rli/city_001.png", smaller),
            "city_001.png: expected 32 x 32 pixels like the view under",
        ),
        "no maps": (beside(gone("maps")), "no such folder"),
        "no such map": (beside(gone("maps/night.exr")), "no environment map of night"),
    },
}
