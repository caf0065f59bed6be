"""Typical mistakes in folders of every format: each is told in one sentence, by the reader or by the check of mesh and masks.

A case spoils a folder that test_round_trips.py reads as it should be read, and says what has to be said of it. What pixels
cannot tell (docs/datasets.md lists it for each reader) is no case. To add one, write a line in the table of its format.
"""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layouts import LAYOUTS, Layout
from spoils import Spoil, array, edited, gone, picture, word, wrote
from test_round_trips import read

from ia_bench.common.errors import InputError
from ia_bench.readers.writers.parts import Options, save_exr
from ia_bench.render.agreement import check_agreement
from ia_bench.scenes.exr import read_exr

Array = np.ndarray
Mistakes = dict[str, tuple[Spoil, str]]
"""By name: what is done to a folder, and what has to be said of it (a regular expression)."""


def matrix(name: str, change: Callable[[Array], Array], *, every: bool = False) -> Spoil:
    """The matrix of the frame 3 of a list of frames, or of every one, changed."""

    def spoil(content: dict[str, Any]) -> None:
        for one in content["frames"][slice(None) if every else slice(3, 4)]:
            one["transform_matrix"] = change(np.array(one["transform_matrix"])).tolist()

    return edited(name, spoil)


def metadata(change: Callable[[Array], Array]) -> Callable[[dict[str, Any]], object]:
    def changed(one: dict[str, Any]) -> None:
        values = change(np.array([float(part) for part in one["cam_transform_mat"].split(",")]).reshape(4, 4))
        one["cam_transform_mat"] = ",".join(repr(float(value)) for value in values.ravel())

    return changed


def in_all(pattern: str, spoil: Callable[[str], Spoil]) -> Spoil:
    return lambda folder: [spoil(path.relative_to(folder).as_posix())(folder) for path in sorted(folder.glob(pattern))]


def without_zeros(name: str, begin: str = "") -> Spoil:
    return lambda folder: [path.rename(path.with_name(f"{begin}{int(path.stem)}.png")) for path in [*(folder / name).iterdir()]]


def arrays(change: Callable[[dict[str, Array]], object]) -> Spoil:
    """The matrices of cameras.npz, changed."""

    def spoil(folder: Path) -> None:
        stored = dict(np.load(folder / CAMERAS))
        change(stored)
        np.savez(folder / CAMERAS, **stored)

    return spoil


def one_matrix(name: str, change: Callable[[Array], Array]) -> Spoil:
    return arrays(lambda stored: stored.update({name: change(stored[name])}))


def posed(change: Callable[[Array], Array], *numbers: int) -> Spoil:
    """The extrinsics of sfm_scene.json, changed."""

    def spoil(content: dict) -> None:
        for key, image in content["camera_track_map"]["images"].items():
            if not numbers or int(key) in numbers:
                image["camera"]["extrinsic"] = change(np.reshape(image["camera"]["extrinsic"], (4, 4))).ravel().tolist()

    return edited(SFM, spoil)


def rows(change: Callable[[Array], Array]) -> Spoil:
    """The matrices (3, 5) of poses_bounds.npy, changed."""

    def spoil(folder: Path) -> None:
        stored = np.load(folder / POSES)
        np.save(folder / POSES, np.array([[*change(row[:15].reshape(3, 5)).ravel(), *row[15:]] for row in stored]))

    return spoil


def smaller(values: Array) -> Array:
    return values[:24, :28]


def other_axes(to_world: Array) -> Array:
    """OpenGL's axes for OpenCV's, or the other way round."""
    return to_world @ np.diag([1.0, -1, -1, 1])


def turned_rows(values: Array) -> Array:
    """OpenGL's axes in the rows K, R, t, size."""
    values[3:7] *= np.array([[1.0], [-1], [-1], [1]])
    values[6] *= [1, -1, -1]
    return values


RESCALED, FARTHER = (np.array([[*row, shift]] * 3 + [[1, 1, 1, 1]]) for row, shift in (((2, 2, 2), 2), ((1, 1, 1), 3)))
SQUEEZED = np.array([[0, 0, 0, 0, 32.0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]])
HUGE_HEADER = b"\x93NUMPY\x01\x00\x76\x00" + b"{'descr':'<f8','fortran_order':False,'shape':(1000000,1000000,3)}".ljust(117) + b"\n"
"""Of a file of three thousand billion numbers, none of which is there."""

AXES = r"look away from it; usually OpenCV's axes .* are exchanged"
RADIANS = "expected radians between 0 and pi, found 38"
MESH = "expected the mesh to cover the masks of the images"
WHOLE, TRAIN, SFM, POSES = "transforms.json", "transforms_train.json", "inputs/sfm_scene.json", "poses_bounds.npy"
CAMERAS = "cameras.npz"
SPARSE, OWN, OUTPUT = "sparse/0", "blender_HDR/object_scene001", "output/transforms_train.json"
NORMALS, META = "ground_truth/object_scene001/surface_normal/0001.npy", "train_003/metadata.json"


def view_folders(photo: str) -> Mistakes:
    return {
        "no views": (in_all("train_*", gone), "expected folders train_000, train_001, ... with metadata.json, found none"),
        "no field of view": (edited(META, lambda m: m.pop("cam_angle_x")), "cam_angle_x: expected a finite number, found None"),
        "degrees": (edited(META, lambda m: m.update(cam_angle_x=38.0)), RADIANS),
        "2 numbers": (edited(META, lambda m: m.update(cam_transform_mat="1,2")), "cam_transform_mat: expected 16 numbers"),
        "scaled": (edited(META, metadata(lambda m: m * RESCALED)), r"cam_transform_mat: expected a rotation.*det = 8"),
        "OpenCV axes": (in_all("*/metadata.json", lambda name: edited(name, metadata(other_axes))), AXES),
        "no mask": (picture(f"train_003/{photo}", to=lambda v: v[..., :3]), rf"{photo}: expected a mask in its alpha"),
        "empty mask": (picture(f"train_003/{photo}", to=np.zeros_like), rf"{photo}: the mask has no pixel of an object"),
        "another size": (picture(f"train_003/{photo}", to=smaller), rf"{photo}: expected 32 x 32 pixels.*found 28 x 24"),
    }


MISTAKES: dict[str, Mistakes] = {
    "nerfstudio": {
        "no file": (gone(WHOLE), "expected transforms.json or transforms_train.json, found neither"),
        "texts of digits": (
            edited(WHOLE, lambda c: c["frames"][3]["transform_matrix"][3].__setitem__(3, "1")),
            r"frames\[3\]: transform_matrix: expected 4 x 4 finite numbers, found shape \(0,\)",
        ),
        "mask not there": (gone("masks/train_0003.png"), r"frames\[3\]: mask_path: masks/train_0003.png: no such file"),
        "mask of another size": (picture("masks/train_0003.png", to=smaller), r"masks/train_0003.png: expected 32 x 32 pixels"),
        "wrong width": (edited(WHOLE, lambda c: c.update(w=64)), "expected w = 64, as .* says, found 32"),
        "focal length in a list": (
            edited(WHOLE, lambda c: c.update(fl_x=[50.0])),
            r"fl_x: expected a finite number, found \[50.0\]",
        ),
        "beyond a float": (word(WHOLE, '"fl_x": ', '"k1": 1e999, "fl_x": '), "k1: expected a finite number, found inf"),
        "fisheye": (edited(WHOLE, lambda c: c.update(camera_model="FISHEYE")), "camera_model: expected one of.*found 'FISHEYE'"),
        "fisheye of Instant-NGP": (
            edited(WHOLE, lambda c: c.update(is_fisheye=bool(c.pop("camera_model")))),
            "camera_model: .* found 'OPENCV_FISHEYE'",
        ),
        "absurd lens": (edited(WHOLE, lambda c: c.update(k1=-40.0)), "expected the distortion of a lens, found one under which"),
        "OpenCV axes": (matrix(WHOLE, other_axes, every=True), AXES),
        "world-to-camera": (matrix(WHOLE, np.linalg.inv, every=True), f"{AXES}|{MESH}.*world-to-camera"),
        "another scale": (matrix(WHOLE, lambda m: m * FARTHER, every=True), MESH),
        "unknown split": (
            edited(WHOLE, lambda c: c["train_filenames"].append("no.png")),
            "train_filenames: expected a list of file",
        ),
    },
    "blender": {
        "no frame": (edited(TRAIN, lambda c: c.update(frames=[])), "expected at least one training view, found none"),
        "no paths": (
            edited(TRAIN, lambda c: [one.pop("file_path") for one in c["frames"]]),
            r"frames\[0\]: file_path: expected the path of a file, found None",
        ),
        "no photograph": (gone("train/r_3.png"), r"frames\[3\]: file_path: \./train/r_3: no such file"),
        "another size": (picture("train/r_3.png", to=smaller), "expected 32 x 32 pixels like train/r_0 with"),
    },
    "tensoir": view_folders("rgba_sunset_000.png"),
    "nerfactor": {
        "a light beyond": (
            edited("train_000/metadata.json", lambda m: m.update(envmap_inten=1e38)),
            r"train_000/metadata\.json: envmap_inten: expected a number up to 1e\+12, found 1e\+38",
        )
    },
    "synthetic4relight": {
        "a folder for frames": (
            lambda at: [gone("transforms_test.json")(at), (at / "transforms_test.json").mkdir()],
            "transforms_test.json: expected a file, found a folder",
        ),
        "relit in another size": (picture("test_rli/city_001.png", to=smaller), "city_001.png: expected 32 x 32 pixels"),
        "no maps": (gone("lights"), "no such folder"),
        "no such map": (gone("lights/night.exr"), "no environment map of night"),
    },
    "dtu": {
        "no cameras": (gone(CAMERAS), "cameras.npz: no such file"),
        "no archive": (wrote(CAMERAS, "no archive"), "cameras.npz: expected arrays of numbers"),
        "a photograph is missing": (gone("image/003.png"), r"expected as many photographs in image/ as cameras \(19\), found 18"),
        "3 x 4": (one_matrix("world_mat_3", lambda m: m[:3]), r"world_mat_3: expected 4 x 4 numbers .*, found shape \(3, 4\)"),
        "complex": (
            one_matrix("world_mat_3", lambda m: m.astype(complex)),
            r"world_mat_3: expected at most .* real numbers, found 16",
        ),
        "beyond": (one_matrix("world_mat_3", lambda m: m * 1e300), r"world_mat_3: expected numbers up to 1e\+12, found "),
        "not finite": (one_matrix("world_mat_3", lambda m: m * np.nan), "world_mat_3: expected finite numbers, found NaN"),
        "other scale": (one_matrix("scale_mat_3", lambda m: 2 * m), "scale_mat_i: expected one positive scale"),
        "no mask": (gone("mask/003.png"), "image/003.png: expected a mask .*mask/003.png, found none"),
        "no zeros": (without_zeros("image"), r"image: expected names in the order .*, found 18\.png before 2\.png; rename them"),
        "no zeros in masks": (without_zeros("mask", "object "), r"mask: .* found object 18\.png before object 2\.png"),
    },
    "colmap": {
        "no model": (gone("sparse"), "expected a sparse model"),
        "broken model": (
            wrote(f"{SPARSE}/cameras.txt", "1 NOTHING 32 32 5\n"),
            "camera 1: expected one of .*, found NOTHING with 1 param",
        ),
        "half a line": (
            wrote(f"{SPARSE}/cameras.txt", "1 PINHOLE\n"),
            r"cameras\.txt: expected cameras of a sparse model of COLMAP",
        ),
        "no image file": (gone(f"{SPARSE}/images.txt"), r"images\.txt: no such file"),
        "another size": (
            picture("images/0004.png", "masks/0004.png.png", to=smaller),
            "0004.png: expected 32 x 32 pixels like camera 1 of the sparse model, found 28 x 24",
        ),
        "fisheye": (word(f"{SPARSE}/cameras.txt", "PINHOLE", "SIMPLE_RADIAL_FISHEYE"), "camera 1: expected one of .*_FISHEYE"),
        "rotation of zeros": (
            wrote(f"{SPARSE}/images.txt", "".join(f"{n} 0 0 0 0 0 0 3 1 {n:04}.png\n\n" for n in range(1, 20))),
            "image 2: expected a rotation as a unit quaternion, found",
        ),
        "one name for two": (word(f"{SPARSE}/images.txt", "0004.png", "0003.png"), "expected every photograph once"),
        "no poses": (wrote(f"{SPARSE}/images.txt", "# nothing\n"), "expected photographs with a pose in the sparse model"),
    },
    "llff": {
        "no poses": (gone(POSES), r"poses_bounds\.npy: no such file"),
        "no zeros": (without_zeros("images"), r"images: expected names in the order .*, found 18\.png before 2\.png; rename them"),
        "a photograph is missing": (gone("images/003.png"), r"expected 18 x 17 numbers, a row a photograph .*\(19, 17\)"),
        "axes of OpenGL": (rows(lambda row: row[:, [1, 0, 2, 3, 4]] * [1, -1, 1, 1, 1]), f"{AXES}|{MESH}"),
        "axes of OpenCV": (rows(lambda row: row * [1, 1, -1, 1, 1]), "row 1: pose: expected a rotation.*det = -1"),
        "no focal length": (rows(lambda row: row * [1, 1, 1, 1, 0]), "expected height, width and focal length above 0, found"),
        "another aspect": (rows(lambda row: row * [1, 1, 1, 1, 1] + SQUEEZED), r"expected the aspect of 32 x 64 pixels"),
    },
    "neilf": {
        "README's key": (edited(SFM, lambda c: c.update(image_list=c.pop("image_path"))), "expected image_path, found none"),
        "12 numbers": (edited(SFM, lambda c: c["bbox"].update(transform=[1.0] * 12)), "bbox.transform: expected 16 finite numbers"),
        "camera-to-world": (posed(np.linalg.inv), f"look away|{MESH}"),
        "no positions": (gone("inputs/position_maps"), r"depth_maps/004.exr: no such file"),
        "no object": (
            lambda folder: save_exr(folder / "inputs/position_maps/005.exr", np.zeros((32, 32, 3))),
            "train view 005: mask: expected a pixel above 0.5, found none",
        ),
        "smaller photographs": (
            edited(SFM, lambda c: c["camera_track_map"]["images"]["5"].update(size=[64, 32])),
            r"images\.5\.size: expected that of photograph 005, 32 x 32, found \[64, 32\]",
        ),
        "focal length in words": (
            edited(SFM, lambda c: c["camera_track_map"]["images"]["3"]["camera"]["intrinsic"].update(focal="48 px")),
            r"images\.3\.camera\.intrinsic\.focal: expected 2 finite numbers, found '48 px'",
        ),
        "focal length beyond": (
            edited(SFM, lambda c: c["camera_track_map"]["images"]["3"]["camera"]["intrinsic"].update(focal=[1e300, 1e300])),
            r"sfm_scene\.json: camera_track_map\.images\.3\.camera\.intrinsic: focal: expected 2 numbers from 0\.032 to 3\.2e\+07",
        ),
        "negative radiance": (
            lambda folder: save_exr(path := folder / "inputs/images/003.exr", read_exr(path, 3) - 0.5),
            r"images/003\.exr: expected radiance, found the negative value -0\.5",
        ),
        "truth of another size": (picture("ground_truths/materials/kd/002.png", to=smaller), "kd/002.png: expected 32 x 32 pixels"),
    },
    "openillumination": {
        "no photographs": (gone("Lights"), "expected the folder of one object, with Lights in it"),
        "no such light": (gone("Lights/013"), "unknown reader.options.pattern '013'"),
        "another width": (edited(OUTPUT, lambda c: c["frames"]["CA3"].update(calib_imgw=50)), "CA3.JPG: expected calib_imgw = 50"),
        "a width beyond": (
            edited(OUTPUT, lambda c: c["frames"]["CA3"].update(calib_imgw=1e300)),
            r"frames\['CA3'\]: calib_imgw: expected a width up to 67108864 pixels, found 1e\+300",
        ),
        "one file for two": (
            edited(OUTPUT, lambda c: c["frames"]["CA3"].update(file_path="./images/CA2")),
            r"frames\['CA3'\]: file_path: expected every photograph once",
        ),
    },
    "objects_with_lighting": {
        "no photographs": (gone("test/inputs"), r"expected photographs image_0000\.png, image_0001\.png, ..., found none"),
        "two exposures": (wrote("test/inputs/exposure.txt", "0.1 0.2\n"), r"exposure\.txt: expected 1 x 1 finite numbers"),
        "exposure beyond": (
            wrote("test/inputs/exposure.txt", "1e5\n"),
            r"exposure\.txt: expected an exposure from -32 to 32 stops",
        ),
        "no numbers": (wrote("test/inputs/camera_0003.txt", "one two three\n"), r"camera_0003\.txt: expected rows of numbers"),
        "another size": (
            picture("test/inputs/mask_0003.png", "test/inputs/image_0003.png", to=smaller),
            r"image_0003\.png: expected 32 x 32 pixels like .*camera_0003\.txt, found 28 x 24",
        ),
        "OpenGL axes": (
            in_all("test/inputs/camera_*.txt", lambda name: lambda f: np.savetxt(f / name, turned_rows(np.loadtxt(f / name)))),
            f"{AXES}|{MESH}|rows 4 to 7",
        ),
        "no map": (gone("test/gt_env_512_rotated_0002.hdr"), r"gt_env_512_rotated_0002\.hdr: no such file"),
    },
    "stanford_orb": {
        "no dataset": (gone("blender_HDR"), "expected the dataset's folder, with blender_HDR in it, found none"),
        "no capture": (gone(OWN), "unknown reader.options.capture 'object_scene001'; did you mean"),
        "transposed": (matrix(f"{OWN}/{TRAIN}", np.transpose), "transform_matrix: expected the last row 0 0 0 1"),
        "OpenCV axes": (matrix(f"{OWN}/{TRAIN}", other_axes, every=True), AXES),
        "capture not there": (gone("blender_HDR/object_scene002"), r"blender_HDR/object_scene002/test/0000\.exr: no such file"),
        "no map": (gone("ground_truth/object_scene002/env_map/0001.exr"), "no environment map .*object_scene002/env_map/0001.exr"),
        "normals in a picture": (array(NORMALS, np.ones((32, 32))), r"0001\.npy: expected \(32, 32, 3\) values"),
        **{
            f"{kind} for normals": (
                array(NORMALS, np.zeros((32, 32, 3), kind)),
                r"0001\.npy: expected at most .* real numbers, found",
            )
            for kind in ("complex", "datetime64[s]", "f4,f4,f4")
        },
        "normals beyond": (array(NORMALS, np.full((32, 32, 3), 1e300)), r"values from -1\.1 to 1\.1, found .*, up to 1e\+300"),
        "a header alone": (wrote(NORMALS, HUGE_HEADER), r"0001\.npy: expected arrays of numbers "),
        "normals of another size": (array(NORMALS, np.ones((48, 32, 3))), r"expected \(32, 32, 3\) values"),
    },
}


def said_of(layout: Layout, folder: Path, given: Options) -> str:
    """What a run is told of the folder: the one error, or all notes."""
    notes: list[str] = []
    try:
        scene = read(layout, folder, given)
        notes += scene.notes
        check_agreement(scene, notes.append)
    except InputError as error:
        return f"error: {error}"
    return "\n".join(notes)


def expect_told(spoil: Spoil, says: str, layout: Layout, written: dict[str, tuple[Path, Options]], place: Path) -> None:
    """Of a copy of a folder that was spoiled this is said, and an error in one line."""
    given, folder = written[layout.id][1], Path(shutil.copytree(written[layout.id][0], place / "tiny"))
    spoil(folder)
    said = said_of(layout, folder, given | ({"lights": str(folder / "lights")} if "lights" in given else {}))
    assert re.search(says, said), said
    assert "\n" not in said or not said.startswith("error")


CASES = [(one, mistake) for one in LAYOUTS for mistake in MISTAKES.get(one.id, {})]


@pytest.mark.parametrize(("layout", "mistake"), CASES, ids=[f"{one.id}-{mistake}" for one, mistake in CASES])
def test_a_typical_mistake_is_told(layout: Layout, mistake: str, written: dict[str, tuple[Path, Options]], tmp_path: Path) -> None:
    expect_told(*MISTAKES[layout.id][mistake], layout, written, tmp_path)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.id)
def test_nothing_is_said_of_a_sound_folder(layout: Layout, written: dict[str, tuple[Path, Options]]) -> None:
    said = said_of(layout, *written[layout.id])
    assert "warning" not in said
    assert "expected" not in said
