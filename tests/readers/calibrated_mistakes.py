"""Typical mistakes in formats with calibrated cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from nerf_mistakes import halved
from spoiled import (
    AXES,
    DEGREES,
    MESH,
    Mistakes,
    Spoil,
    black,
    both,
    broken_json,
    edit,
    farther,
    frame,
    gone,
    in_all,
    matrix,
    other_axes,
    picture,
    rescaled,
    smaller,
    srgb_as_linear_in,
    text,
)
from written import save_exr

from ia_bench.scenes.exr import read_exr

CAMERAS, SFM, TRAIN = "cameras.npz", "inputs/sfm_scene.json", "transforms_train.json"
NORMALS = "ground_truth/tiny_scene001/surface_normal"
SPARSE, OWN = "sparse/0", "blender_HDR/tiny_scene001"

HUGE_HEADER = b"\x93NUMPY\x01\x00\x76\x00" + b"{'descr':'<f8','fortran_order':False,'shape':(1000000,1000000,3)}".ljust(117) + b"\n"
"""Of a file of three thousand billion numbers, none of which is there."""


def arrays(change: Callable[[dict[str, np.ndarray]], object]) -> Spoil:
    """The matrices of cameras.npz, changed."""

    def spoil(folder: Path) -> None:
        stored = dict(np.load(folder / CAMERAS))
        change(stored)
        np.savez(folder / CAMERAS, **stored)

    return spoil


def one_matrix(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return arrays(lambda stored: stored.update({name: change(stored[name])}))


def word(name: str, old: str, new: str) -> Spoil:
    return lambda folder: (folder / name).write_text((folder / name).read_text().replace(old, new))


def rows(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda folder: np.savetxt(folder / name, change(np.loadtxt(folder / name)))


def turned(values: np.ndarray) -> np.ndarray:
    """OpenGL's axes in the rows K, R, t, size."""
    values[3:7] *= np.array([[1.0], [-1], [-1], [1]])
    values[6] *= [1, -1, -1]
    return values


def posed(change: Callable[[np.ndarray], np.ndarray], *numbers: int) -> Spoil:
    """The extrinsics of sfm_scene.json, changed."""

    def spoil(content: dict) -> None:
        for key, image in content["camera_track_map"]["images"].items():
            if not numbers or int(key) in numbers:
                image["camera"]["extrinsic"] = change(np.reshape(image["camera"]["extrinsic"], (4, 4))).ravel().tolist()

    return edit(SFM, spoil)


def array(name: str, values: np.ndarray) -> Spoil:
    return lambda folder: np.save(folder / name, values)


def radiance(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda folder: save_exr(folder / name, change(read_exr(folder / name, 3)))


def entry(change: Callable[[dict], object]) -> Spoil:
    """What sfm_scene.json says of its photograph 3, changed."""
    return edit(SFM, lambda content: change(content["camera_track_map"]["images"]["3"]))


def entry_is(value: object) -> Spoil:
    return edit(SFM, lambda content: content["camera_track_map"]["images"].update({"3": value}))


LISTED: Mistakes = {
    "empty mask": (picture("mask/003.png", black), "mask/003.png: the mask has no pixel of an object"),
}
OPEN: Mistakes = {
    "no photographs": (gone("Lights"), "expected the folder of one object, with Lights in it"),
    "no such light": (gone("Lights/013"), "unknown reader.options.pattern '013'"),
    "no frames file": (gone("output/transforms_train.json"), r"transforms_train\.json: no such file"),
    "broken JSON": (broken_json("output/transforms_train.json"), r"transforms_train\.json: not valid JSON"),
    "no photograph": (gone("Lights/013/raw_undistorted/CA3.JPG"), "CA3.JPG: no such file"),
    "no mask": (gone("output/com_masks/CA3.png"), "com_masks/CA3.png: no such file"),
    "mask of another size": (picture("output/com_masks/CA3.png", smaller), "CA3.png: expected 32 x 32 pixels"),
    "no picture": (text("Lights/013/raw_undistorted/CA3.JPG", "no"), "CA3.JPG: expected a picture"),
    "degrees": (
        edit("output/transforms_train.json", lambda c: c["frames"]["CA3"].update(camera_angle_x=38.0)),
        DEGREES,
    ),
    "scaled": (
        edit("output/transforms_train.json", lambda c: matrix(rescaled)(c["frames"]["CA3"])),
        r"frames\['CA3'\]: transform_matrix: expected a rotation.*det = 8",
    ),
    "another width": (
        edit("output/transforms_train.json", lambda c: c["frames"]["CA3"].update(calib_imgw=50)),
        "CA3.JPG: expected 50 x 32 pixels like calib_imgw",
    ),
    "one file for two": (
        edit("output/transforms_train.json", lambda c: c["frames"]["CA3"].update(file_path="./images/CA2")),
        r"frames\['CA3'\]: file_path: expected every photograph once",
    ),
    "a width beyond": (
        edit("output/transforms_train.json", lambda c: c["frames"]["CA3"].update(calib_imgw=1e300)),
        "CA3.JPG: expected 1000000000 x 32 pixels like calib_imgw",
    ),
    "a width as text": (
        edit("output/transforms_train.json", lambda c: c["frames"]["CA3"].update(calib_imgw="48")),
        r"frames\['CA3'\]: calib_imgw: expected a finite number, found '48'",
    ),
}

MISTAKES: dict[str, Mistakes] = {
    "dtu": {
        **LISTED,
        "no photographs": (gone("image"), "expected a folder of photographs, found none"),
        "no cameras": (gone(CAMERAS), "cameras.npz: no such file"),
        "no archive": (text(CAMERAS, "no archive"), "cameras.npz: expected arrays of numbers"),
        "fewer cameras": (
            arrays(lambda a: a.pop("world_mat_18")),
            r"cameras\.npz: expected as many photographs in image/ as cameras \(18\), found 19",
        ),
        "a photograph is missing": (
            gone("image/003.png"),
            r"cameras\.npz: expected as many photographs in image/ as cameras \(19\), found 18",
        ),
        "a camera of another name": (
            arrays(lambda a: a.update(world_mat_19=a.pop("world_mat_4"))),
            "expected world_mat_4 for the 19 photographs in image/, found none of that name",
        ),
        "no scale": (arrays(lambda a: a.pop("scale_mat_0")), "expected scale_mat_0 for the 19 photographs"),
        "3 x 4": (one_matrix("world_mat_3", lambda m: m[:3]), r"world_mat_3: expected 4 x 4 finite numbers, found shape \(3, 4\)"),
        "not finite": (one_matrix("world_mat_3", lambda m: m * np.nan), "world_mat_3: expected finite numbers, found NaN"),
        "complex": (one_matrix("world_mat_3", lambda m: m * (1 + 1j)), "world_mat_3: expected .* real numbers, found 16 of"),
        "other scale": (one_matrix("scale_mat_3", lambda m: 2 * m), "scale_mat_3: expected the same as scale_mat_0"),
        "stretched": (one_matrix("scale_mat_0", lambda m: m @ np.diag([1, 2, 1, 1.0])), "scale_mat_0: expected one positive scale"),
        "no mask": (gone("mask/003.png"), "image/003.png: expected a mask .*mask/003.png, found none"),
        "inverse": (
            arrays(
                lambda a: a.update({k: np.linalg.inv(m) for k, m in a.items() if k.startswith("world_mat_") and "inv" not in k})
            ),
            "expected rectangular pixels|look away|expected the mesh|positive focal",
        ),
        "another photograph more": (
            lambda f: (f / "image" / "999.png").write_bytes((f / "image" / "000.png").read_bytes()),
            r"expected as many photographs in image/ as cameras \(19\), found 20",
        ),
    },
    "colmap": {
        "no model": (gone("sparse"), "expected a sparse model"),
        "broken model": (text(f"{SPARSE}/cameras.txt", "1 NOTHING 32 32 5\n"), "expected a sparse model of COLMAP, found"),
        "no photographs": (gone("images"), r"sparse model: image .*: images/000.*.png: no such file"),
        "no photograph": (gone("images/0004.png"), "images/0004.png: no such file"),
        "no mask": (gone("masks/0004.png.png"), "images/0004.png: expected a mask .*masks/0004.png, found none"),
        "another size": (
            both(picture("images/0004.png", smaller), picture("masks/0004.png.png", smaller)),
            "0004.png: expected 32 x 32 pixels like camera 1 of the sparse model, found 28 x 24",
        ),
        "fisheye": (
            word(f"{SPARSE}/cameras.txt", "OPENCV", "OPENCV_FISHEYE"),
            "camera 1: expected one of .*, found OPENCV_FISHEYE",
        ),
        "absurd lens": (
            word(f"{SPARSE}/cameras.txt", " 0.0 0.0 0.0 0.0", " -40.0 0.0 0.0 0.0"),
            "found one under which the picture folds",
        ),
        "rotation of zeros": (
            lambda f: (f / SPARSE / "images.txt").write_text("".join(f"{n} 0 0 0 0 0 0 3 1 {n:04}.png\n\n" for n in range(1, 20))),
            "image 2: expected a rotation as a unit quaternion, found",
        ),
        "one name for two": (word(f"{SPARSE}/images.txt", "0004.png", "0003.png"), "expected every photograph once"),
        "no poses": (
            text(f"{SPARSE}/images.txt", "# nothing\n"),
            "expected photographs with a pose in the sparse model, found none",
        ),
    },
    "neilf": {
        "no file": (gone(SFM), r"sfm_scene\.json: no such file"),
        "README's key": (edit(SFM, lambda c: c.update(image_list=c.pop("image_path"))), "expected image_path, found none"),
        "no box": (edit(SFM, lambda c: c.pop("bbox")), "expected bbox, found none"),
        "12 numbers": (edit(SFM, lambda c: c["bbox"].update(transform=[1.0] * 12)), "bbox.transform: expected 16 finite numbers"),
        "no poses": (edit(SFM, lambda c: c["camera_track_map"].update(images={})), "expected 0, found none"),
        "scaled": (posed(rescaled, 3), r"camera.extrinsic: expected a rotation.*det = 8"),
        "camera-to-world": (posed(np.linalg.inv), f"look away|{MESH}"),
        "OpenGL axes": (posed(lambda m: np.diag([1.0, -1, -1, 1]) @ m), AXES),
        "no photograph": (gone("inputs/images/003.exr"), "images/003.exr: no such file"),
        "no positions": (gone("inputs/position_maps"), r"depth_maps/000.exr: no such file"),
        "empty positions": (gone("inputs/position_maps/003.exr"), "position_maps/003.exr: no such file"),
        "no focal length": (
            entry(lambda one: one["camera"]["intrinsic"].pop("focal")),
            "camera.intrinsic: expected two numbers each of focal and ppt",
        ),
        "focal length beyond": (
            entry(lambda one: one["camera"]["intrinsic"].update(focal=[1e300, 1e300])),
            "train view 003: camera: focal: expected 2 numbers from",
        ),
        "entry in a list": (entry_is([2]), r"sfm_scene\.json: camera_track_map\.images\['3'\]: expected an object, found list"),
        "entry null": (entry_is(None), r"sfm_scene\.json: camera_track_map\.images\['3'\]: expected an object, found NoneType"),
        "camera null": (entry(lambda one: one.update(camera=None)), r"images\['3'\]: expected camera\.intrinsic, found none"),
        "intrinsics in a list": (
            entry(lambda one: one["camera"].update(intrinsic=[48.0, 48.0])),
            r"images\['3'\]: camera\.intrinsic: expected two numbers each of focal and ppt, found \[48\.0, 48\.0\]",
        ),
        "focal length in words": (
            entry(lambda one: one["camera"]["intrinsic"].update(focal="48 px")),
            r"images\['3'\]: camera\.intrinsic: expected two numbers each of focal and ppt, found .*48 px",
        ),
        "file null": (
            edit(SFM, lambda c: c["image_path"]["file_paths"].update({"3": None})),
            r"sfm_scene\.json: image_path\.file_paths: 3: expected text, found None",
        ),
        "negative radiance": (
            radiance("inputs/images/003.exr", lambda image: image - 0.5),
            r"images/003\.exr: expected radiance, found the negative value -0\.5",
        ),
        "sRGB as linear": (srgb_as_linear_in("inputs/images"), "warning: the linear images hold 8-bit steps from 0 to 1 only"),
        "truth of another size": (picture("ground_truths/materials/kd/009.png", smaller), "kd/009.png: expected 32 x 32 pixels"),
    },
    "openillumination": OPEN,
    "openillumination_opengl": {},
    "objects_with_lighting": {
        "no photographs": (gone("test/inputs"), r"expected photographs image_0000\.png, image_0001\.png, ..., found none"),
        "no exposure": (gone("test/inputs/exposure.txt"), r"exposure\.txt: no such file"),
        "two exposures": (text("test/inputs/exposure.txt", "0.1 0.2\n"), r"exposure\.txt: expected one number, found 2"),
        "exposure beyond": (text("test/inputs/exposure.txt", "1e5\n"), r"exposure\.txt: expected an exposure from -32 to 32 stops"),
        "no numbers": (text("test/inputs/camera_0003.txt", "one two three\n"), r"camera_0003\.txt: expected rows of numbers"),
        "12 numbers": (
            rows("test/inputs/camera_0003.txt", lambda m: m[:4]),
            r"expected 8 rows of 3 numbers .*, found shape \(4, 3\)",
        ),
        "no camera": (gone("test/inputs/camera_0003.txt"), r"inputs/camera_0003\.txt: no such file"),
        "no mask": (gone("test/inputs/mask_0003.png"), r"inputs/mask_0003\.png: no such file"),
        "another size": (
            both(picture("test/inputs/mask_0003.png", smaller), picture("test/inputs/image_0003.png", smaller)),
            r"image_0003\.png: expected 32 x 32 pixels like .*camera_0003\.txt, found 28 x 24",
        ),
        "OpenGL axes": (in_all("test/inputs/camera_*.txt", lambda name: rows(name, turned)), f"{AXES}|{MESH}|rows 4 to 7"),
        "no map": (gone("test/gt_env_512_rotated_0002.hdr"), r"gt_env_512_rotated_0002\.hdr: no such file"),
        "no Radiance map": (text("test/gt_env_512_rotated_0002.hdr", "no"), "expected a Radiance picture, which begins with"),
    },
    "stanford_orb": {
        "no dataset": (gone("blender_HDR"), "expected the dataset's folder, with blender_HDR in it, found none"),
        "no capture": (gone(OWN), "unknown reader.options.capture 'tiny_scene001'; did you mean"),
        "no frames file": (gone(f"{OWN}/{TRAIN}"), r"transforms_train\.json: no such file"),
        "no photograph": (gone(f"{OWN}/train/0003.exr"), r"train/0003\.exr: no such file"),
        "no mask": (gone(f"{OWN}/train_mask/0003.png"), r"train_mask/0003\.png: no such file"),
        "transposed": (frame(f"{OWN}/{TRAIN}", matrix(np.transpose)), "transform_matrix: expected the last row 0 0 0 1"),
        "OpenCV axes": (frame(f"{OWN}/{TRAIN}", matrix(other_axes), every=True), AXES),
        "another unit": (frame(f"{OWN}/{TRAIN}", matrix(farther), every=True), MESH),
        "nearer": (frame(f"{OWN}/{TRAIN}", matrix(halved), every=True), MESH),
        "capture not there": (gone("blender_HDR/tiny_scene002"), r"blender_HDR/tiny_scene002/test/0000\.exr: no such file"),
        "no map": (gone("ground_truth/tiny_scene002/env_map/0001.exr"), "no environment map .*tiny_scene002/env_map/0001.exr"),
        "normals in a picture": (
            array(f"{NORMALS}/0001.npy", np.ones((32, 32))),
            r"0001\.npy: expected finite values \(H, W, 3\)",
        ),
        **{
            f"normals as {name}": (array(f"{NORMALS}/0001.npy", values), rf"0001\.npy: expected {says}")
            for name, values, says in (
                ("complex", np.ones((32, 32, 3), complex), "at most .* real numbers, found 3072 of complex128"),
                ("dates", np.zeros((32, 32, 3), "datetime64[s]"), "at most .* real numbers"),
                ("records", np.zeros((32, 32), [("x", float), ("y", float), ("z", float)]), "at most .* real numbers"),
                ("large", np.full((32, 32, 3), 1e300), r"finite values \(H, W, 3\) from -1.1 to 1.1, found .* up to 1e\+300"),
            )
        },
        "normals in a header alone": (
            lambda f: (f / f"{NORMALS}/0001.npy").write_bytes(HUGE_HEADER),
            r"0001\.npy: expected arrays of numbers \(.npy, .npz\), found a damaged file or another one",
        ),
        "normals of another size": (
            array(f"{NORMALS}/0001.npy", np.ones((48, 32, 3))),
            "expected 32 x 32 values, or a multiple of these",
        ),
        "opaque albedo of another size": (
            picture("ground_truth/tiny_scene001/pseudo_gt_albedo/0001.png", smaller),
            "0001.png: expected 32 x 32 pixels like its photograph",
        ),
        "sRGB as linear": (srgb_as_linear_in(f"{OWN}/train"), "warning: the linear images hold 8-bit steps"),
    },
}
