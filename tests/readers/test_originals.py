"""Folders as the originals write them, made by hand: none of our writers took part.

Names of files, binary layouts and formulas are those of the programs' own sources: COLMAP's read_write_model.py, IDR's
scene_dataset.py with the names of its DTU scans, BlenderNeRF's operators, Instant-NGP's nerf_loader.cu, nerfstudio's data parser.
"""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.readers.colmap import ColmapReader
from ia_bench.readers.dtu import DtuReader
from ia_bench.readers.llff import LlffReader
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.scenes.scene import View

WIDTH, HEIGHT, COUNT = 40, 30, 9
POINTS = np.array([[0.3, -0.2, 0.4], [-0.5, 0.1, 0.2], [0.1, 0.2, -0.3]])
K = np.array([[50.0, 0, 19], [0, 51, 16], [0, 0, 1]])


def to_camera(number: int) -> np.ndarray:
    """World-to-camera (4, 4) of OpenCV: +z towards the origin, from 4 away and 1 above, +y down."""
    angle = 2 * np.pi * number / COUNT
    place = np.array([4 * np.cos(angle), 4 * np.sin(angle), 1.0])
    ahead = -place / np.linalg.norm(place)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    return np.vstack([np.c_[rotation, -rotation @ place], [0, 0, 0, 1]])


def seen(number: int) -> np.ndarray:
    """Where K [R | t] of a camera has POINTS, (N, 2), in whatever count of pixels K is."""
    x, y, z = K @ (to_camera(number) @ np.c_[POINTS, np.ones(len(POINTS))].T)[:3]
    return np.stack([x / z, y / z], -1)


def save(path: Path, *, alpha: bool = False) -> None:
    """A photograph, or its mask where the folder is called so."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    mask = np.where((columns - 20) ** 2 + (rows - 15) ** 2 < 100, 255, 0).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    photo = np.dstack([np.full((HEIGHT, WIDTH, 3), 120, np.uint8), mask])
    is_mask = "mask" in str(path.parent.name) or "mask" in str(path.parent.parent.name)
    Image.fromarray(mask if is_mask else photo if alpha else photo[..., :3]).save(path, quality=95)


def expect_seen(view: View, number: int, first_pixel: float) -> None:
    """The camera has POINTS where the original's formula has them; ours counts from the corner of the first pixel."""
    columns, rows, depths = view.camera.project(POINTS)
    assert (depths > 0).all()
    np.testing.assert_allclose(np.stack([columns, rows], -1), seen(number) + 0.5 - first_pixel, atol=1e-4)


# ---------------------------------------------------------------- COLMAP
def quaternion(rotation: np.ndarray) -> np.ndarray:
    """The eigenvector by which Bar-Itzhack's method finds (w, x, y, z)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    lower = [[a - e - i, 0, 0, 0], [d + b, e - a - i, 0, 0], [g + c, h + f, i - a - e, 0], [h - f, c - g, d - b, a + e + i]]
    x, y, z, w = np.linalg.eigh(np.array(lower) / 3)[1][:, -1]
    return np.array([w, x, y, z])


PHOTOS = [f"side {number % 2}/été {number}.JPG" for number in range(COUNT)]


def write_model(folder: Path, model: int = 1, parameters: tuple[float, ...] = (50, 51, 19, 16)) -> None:
    """A binary model whose photographs are in another order than their names."""
    images = struct.pack("<Q", COUNT)
    for number in (4, 2, 8, 0, 1, 3, 5, 6, 7):
        matrix = to_camera(number)
        images += struct.pack("<I7dI", 3 * number + 7, *quaternion(matrix[:3, :3]), *matrix[:3, 3], 5)
        images += PHOTOS[number].encode() + b"\0" + struct.pack("<Q2dq", 1, 1.5, 2.5, -1)
        save(folder / "images" / PHOTOS[number])
        save(folder / "masks" / f"{PHOTOS[number]}.png")
    (folder / "sparse" / "0").mkdir(parents=True)
    (folder / "sparse" / "0" / "images.bin").write_bytes(images)
    cameras = struct.pack(f"<QIiQQ{len(parameters)}d", 1, 5, model, WIDTH, HEIGHT, *parameters)
    (folder / "sparse" / "0" / "cameras.bin").write_bytes(cameras)


def test_a_binary_model_of_colmap_and_a_second_one_that_is_left_out(tmp_path: Path) -> None:
    write_model(tmp_path)
    scene = ColmapReader(tmp_path).read(truth=False)
    assert {f"{view.name}.JPG" for view in (*scene.train, *scene.test)} == set(PHOTOS)
    for view in (*scene.train, *scene.test):
        expect_seen(view, PHOTOS.index(f"{view.name}.JPG"), 0.5)
    (tmp_path / "sparse" / "1").mkdir()
    (tmp_path / "sparse" / "1" / "cameras.bin").write_bytes(b"")
    assert "sparse/1 is another sparse model and left out" in ColmapReader(tmp_path).read(truth=False).notes


def test_a_model_in_text_as_editors_of_windows_save_it(tmp_path: Path) -> None:
    """With a byte order mark and carriage returns."""
    write_model(tmp_path)
    lines = {"cameras": [f"5 PINHOLE {WIDTH} {HEIGHT} 50 51 19 16"], "images": list[str]()}
    for number, name in enumerate(PHOTOS):
        matrix = to_camera(number)
        pose = " ".join(str(float(value)) for value in (*quaternion(matrix[:3, :3]), *matrix[:3, 3]))
        lines["images"] += [f"{number + 1} {pose} 5 {name}", "1.5 2.5 -1"]
    for kind, content in lines.items():
        (tmp_path / "sparse" / "0" / f"{kind}.bin").unlink()
        (tmp_path / "sparse" / "0" / f"{kind}.txt").write_bytes("\r\n".join(content).encode("utf-8-sig"))
    for view in ColmapReader(tmp_path).read(truth=False).train:
        expect_seen(view, PHOTOS.index(f"{view.name}.JPG"), 0.5)


def test_parameters_of_colmaps_lenses(tmp_path: Path) -> None:
    write_model(tmp_path, 4, (50, 51, 19, 16, 0.0, 0.0, 0.0, 0.0))
    camera = ColmapReader(tmp_path).read(truth=False).train[0].camera
    assert (camera.focal, camera.centre) == ((50, 51), (19, 16))


@pytest.mark.parametrize(("model", "count", "name"), [(5, 8, "OPENCV_FISHEYE"), (6, 12, "FULL_OPENCV"), (15, 4, "FISHEYE")])
def test_a_lens_of_colmap_that_is_not_undone_is_named(tmp_path: Path, model: int, count: int, name: str) -> None:
    write_model(tmp_path, model, (50.0,) * count)
    with pytest.raises(InputError, match=rf"camera 5: expected one of .*, found {name} with {count} parameters"):
        ColmapReader(tmp_path).read(truth=False)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_a_binary_model_that_ends_too_early(tmp_path: Path, file: str) -> None:
    """Wherever it ends: COLMAP's own library reads on without an end where that is within a name."""
    write_model(tmp_path)
    path = tmp_path / "sparse" / "0" / file
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=rf"{file}: expected \w+ of a sparse model of COLMAP, found damaged or missing data"):
            ColmapReader(tmp_path).read(truth=False)


# ---------------------------------------------------------------- IDR, NeuS and LLFF
@pytest.mark.parametrize(
    ("photo", "mask", "cameras"),
    [("{:06}.png", "{:03}.png", "cameras.npz"), ("{:03}.png", "{:03}.png", "cameras_sphere.npz")],
    ids=["IDR", "NeuS"],
)
def test_a_scan_of_dtu(tmp_path: Path, photo: str, mask: str, cameras: str) -> None:
    scale, matrices = np.diag([30.0, 30, 30, 1]), dict[str, Any]()
    scale[:3, 3] = 10, -20, 600
    for number in range(COUNT):
        world = to_camera(number) @ np.linalg.inv(scale)  # of millimetres, and of any scale
        matrices[f"world_mat_{number}"] = np.vstack([K @ world[:3], [0, 0, 0, 1]]).astype(np.float32)
        matrices |= {f"scale_mat_{number}": scale.astype(np.float32), f"camera_mat_{number}": np.eye(4)}
        save(tmp_path / "image" / photo.format(number))
        save(tmp_path / "mask" / mask.format(number))
    np.savez(tmp_path / cameras, **matrices)
    scene = DtuReader(tmp_path).read(truth=False)
    assert any("000.png is that of 000000.png" in note for note in scene.notes) == (photo != mask)
    for number, view in zip((1, 2, 3, 4, 5, 6, 7, 0, 8), (*scene.train, *scene.test), strict=True):
        expect_seen(view, number, 0.0)
        assert view.mask.sum() == 305


@pytest.mark.parametrize("count", [COUNT, COUNT - 1])
def test_masks_of_other_names_are_taken_in_their_order_if_there_are_as_many(tmp_path: Path, count: int) -> None:
    rows = []
    for number in range(COUNT):  # LLFF's load_colmap_data: columns -u, r, -t of [r, -u, t], the place, and height, width, focal
        right, down, ahead, place = np.linalg.inv(to_camera(number))[:3].T
        rows.append([*np.stack([down, right, -ahead, place, [HEIGHT, WIDTH, 50]], -1).ravel(), 1, 9])
        save(tmp_path / "images" / f"IMG_{number}.JPG")
    for number in range(count):
        save(tmp_path / "masks" / f"{number:03}.png")
    np.save(tmp_path / "poses_bounds.npy", rows)
    if count == COUNT:
        view = LlffReader(tmp_path).read(truth=False).train[0]
        np.testing.assert_allclose(view.camera.to_world, np.linalg.inv(to_camera(1)) @ np.diag([1, -1, -1, 1]), atol=1e-12)
    else:
        with pytest.raises(InputError, match=r"IMG_\d.JPG: expected a mask .*IMG_\d.png, found none"):
            LlffReader(tmp_path).read(truth=False)


# ---------------------------------------------------------------- transforms.json
def write_frames(path: Path, folder: str, numbers: range, **more: object) -> None:
    """A file of frames as BlenderNeRF writes it."""
    frames = [
        {
            "file_path": f"{folder}{number + 1:04}.png",
            "transform_matrix": (np.linalg.inv(to_camera(number)) @ np.diag([1, -1, -1, 1])).tolist(),
        }
        for number in numbers
    ]
    size = {"fl_x": 50.0, "fl_y": 51.0, "cx": 19.0, "cy": 16.0, "w": float(WIDTH), "h": float(HEIGHT), "aabb_scale": 4}
    path.write_text(json.dumps({"camera_angle_x": 0.7, **size, **more, "frames": frames}))


@pytest.mark.parametrize("folder", ["train/", "train\\"], ids=["", "Windows"])
def test_blender_nerf_writes_no_test_photographs(tmp_path: Path, folder: str) -> None:
    for number in range(0, COUNT, 3):
        save(tmp_path / "train" / f"{number + 1:04}.png", alpha=True)
    write_frames(tmp_path / "transforms_train.json", folder, range(0, COUNT, 3))
    write_frames(tmp_path / "transforms_test.json", "test/", range(COUNT))
    scene = NerfstudioReader(tmp_path).read(truth=False)
    assert [view.name for view in scene.train] == ["train/0004", "train/0007"]
    for view, number in zip((*scene.test, *scene.train), (0, 3, 6), strict=True):
        expect_seen(view, number, 0.5)
    assert "transforms_test.json: none of its 9 photographs is there" in scene.notes
    assert "transforms_train.json names no test photographs: every 8th of 3 is held out" in scene.notes
    (tmp_path / "transforms_test.json").unlink()
    assert [view.name for view in NerfstudioReader(tmp_path, every=2).read(truth=False).test] == ["train/0001", "train/0007"]
    write_frames(tmp_path / "transforms_train.json", folder, range(1))
    assert [view.name for view in NerfstudioReader(tmp_path).read(truth=False).train] == ["train/0001"]
    write_frames(tmp_path / "transforms_train.json", folder, range(0, COUNT, 3))
    write_frames(tmp_path / "transforms_test.json", "test/", range(COUNT))
    save(tmp_path / "test" / "0001.png", alpha=True)
    with pytest.raises(InputError, match=r"transforms_test.json: frames\[1\]: file_path: test/0002.png: no such file"):
        NerfstudioReader(tmp_path).read(truth=False)


def whole(tmp_path: Path, **more: object) -> Callable[[], View]:
    for number in range(COUNT):
        save(tmp_path / "images" / f"{number + 1:04}.png", alpha=True)
    write_frames(tmp_path / "transforms.json", "images/", range(COUNT), **more)
    return lambda: NerfstudioReader(tmp_path).read(truth=False).train[0]


@pytest.mark.parametrize("key", ["equirectangular", "latlong", "ftheta_p0"])
def test_a_lens_of_instant_ngp_is_refused(tmp_path: Path, key: str) -> None:
    with pytest.raises(InputError, match=rf"transforms.json: frames\[1\]: camera_model: expected one of .*, found '{key}'"):
        whole(tmp_path, **{key: 0.0 if key == "ftheta_p0" else True})()


def test_coefficients_count_whatever_the_model_is_called(tmp_path: Path) -> None:
    """As nerfstudio's parser takes them: a pinhole model with k1 is undone like OPENCV's."""
    views = [whole(tmp_path, camera_model=model, k1=0.3)() for model in ("PINHOLE", "OPENCV")]
    assert np.array_equal(views[0].mask, views[1].mask)
    assert views[0].mask.sum() < 0.98 * 305
