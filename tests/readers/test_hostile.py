"""Every kind of wrong file that a native scene can have is one sentence.

A case is a name, what is done to a copy of the scene `tiny` of few views, and what the line has to say besides the folder. To add
one, add it to the table of its kind; mistakes of one kind are mended in one place (`common/files.py`, `readers/contract.py`).
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from spoils import Spoil, edited, exr, gone, wrote

from ia_bench.cli.check import main as check
from ia_bench.cli.run import main as run
from ia_bench.common.errors import InputError
from ia_bench.runs.config import ReaderConfig, SceneConfig
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.exr import read_exr

Case = tuple[str, Spoil, str]
SCENE, TRAIN, NOVEL = "scene.json", "transforms_train.json", "transforms_novel.json"
IMAGE, LIGHT, TEXTURE = "images/train/0001.exr", "lights/train.exr", "truth/albedo.png"


# ---------------------------------------------------------------- how files are spoiled
def cut(name: str, share: float) -> Spoil:
    def spoil(folder: Path) -> None:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(share * len(content))])

    return spoil


def into(name: str, kind: str) -> Spoil:
    """A folder, a link to itself, to nothing or out of the scene's folder in place of a file."""

    def spoil(folder: Path) -> None:
        path = (folder / name).rename(folder.parent / "moved").parent / "scene" / name
        leads = {"loop": path.name, "nowhere": "nowhere", "outside": folder.parent / "moved"}
        path.mkdir() if kind == "folder" else path.symlink_to(leads[kind])

    return spoil


def edit(name: str, *keys: str | int, value: Any) -> Spoil:
    """Put ``value`` at a place of a JSON file; ... removes what is there."""

    def change(place: Any) -> None:
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value
        if value is ...:
            del place[keys[-1]]

    return edited(name, change)


def lossy(name: str, at: tuple[int, ...], value: float) -> Spoil:
    """One value of an image changed, also to what write_exr refuses."""

    def spoil(folder: Path) -> None:
        image = read_exr(folder / name, None)
        image[at] = value
        channels = {channel: image[..., i].astype(np.float16) for i, channel in enumerate("RGBA"[: image.shape[-1]])}
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
            file.write(str(folder / name))

    return spoil


def turned(how: Callable[[np.ndarray], object]) -> Spoil:
    """The matrix of a frame, changed."""

    def change(content: dict[str, Any]) -> None:
        content["frames"][1]["transform_matrix"] = how(np.array(content["frames"][1]["transform_matrix"]))

    return edited(TRAIN, change)


# ---------------------------------------------------------------- the table
NO_JSON: dict[str, bytes] = {
    "binary": bytes(range(256)),
    "half": b'{"name": "tin',
    "a list": b"[1]",
    "nested brackets": b"[" * 100_000,
    "beyond a float": b'{"a": ' + b"9" * 400 + b"}",
}
NO_PATH: dict[str, Any] = {
    "number": 5,
    "5000 characters": "a" * 5000,
    "surrogate": "\ud800",
    "above": "../../../../../../../../etc/hostname",
    "folder": "images",
}
INTRINSICS = (("camera_angle_x", 4.0), ("camera_angle_x", "wide"), ("fl_x", -3.0), ("cy", True), ("w", 31))
PATHS = {
    "file_path": (TRAIN, "frames", 1, "file_path"),
    "albedo_path": (TRAIN, "frames", 1, "albedo_path"),
    "lights.train": (SCENE, "lights", "train"),
    "truth_textures.albedo": (SCENE, "truth_textures", "albedo"),
}


def cases() -> Iterator[Case]:
    for name, content in NO_JSON.items():
        yield f"{SCENE}: {name}", wrote(SCENE, content), SCENE
    yield f"{TRAIN}: half", wrote(TRAIN, NO_JSON["half"]), TRAIN
    for file in (SCENE, TRAIN, "mesh.ply"):
        yield from ((f"{file}: {kind}", into(file, kind), file) for kind in ("folder", "loop"))
    for key, place in PATHS.items():
        for name, value in NO_PATH.items():
            yield f"{key}: {name}", edit(*place, value=value), f"{place[0]}: .*{key}"
    for kind in ("folder", "loop", "nowhere", "outside"):
        yield f"image: {kind}", into(IMAGE, kind), r"frames\[1\]: file_path: images/train/0001.exr: "
    for file in (IMAGE, LIGHT, TEXTURE, "mesh.ply"):
        yield f"{file}: text", wrote(file, b"ply, or is it?\n" * 99), file
        yield f"{file}: half", cut(file, 0.5), file
    bomb = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\3\0\0\0\3\0\0\x08\2\0\0\0"
    yield "texture: too many pixels", wrote(TEXTURE, bomb), TEXTURE
    yield "texture: oblong", lambda folder: Image.new("RGB", (20, 7)).save(folder / TEXTURE), "albedo texture: expected"
    yield "texture: an EXR file", lambda folder: shutil.copy(folder / LIGHT, folder / TEXTURE), TEXTURE
    yield "image: a PNG file", lambda folder: Image.new("RGBA", (32, 32)).save(folder / IMAGE, format="png"), IMAGE
    yield "light: square", exr(LIGHT, 3, lambda light: light[:, ::2]), f"{LIGHT}: expected a lat-long map, .*found 64 x 64"
    yield "schema", edit(SCENE, "schema", value=99), "schema: expected 1, found 99"
    yield "name", edit(SCENE, "name", value=5), "name: expected text, found 5"
    yield "surrogate in the name", edit(SCENE, "name", value="\ud800"), "name: expected one line of text"
    yield "splits: more", edit(SCENE, "splits", "train", value=5), "splits: expected 5 train views, found 2"
    yield "twice", edit(TRAIN, "frames", 1, "file_path", value="images/train/0000.exr"), "every photograph once"
    yield "light: number", edit(NOVEL, "frames", 0, "light", value=5), r"frames\[0\]: light: expected text"
    matrix = (TRAIN, "frames", 1, "transform_matrix")
    yield "matrix: text", edit(*matrix, value="[[1]]"), r"frames\[1\]: transform_matrix"
    yield "matrix: large", edit(*matrix, 0, 0, value=1e300), r"frames\[1\]: transform_matrix"
    matrices = {
        "scaled": lambda m: (m * np.array([[1.01, 1.01, 1.01, 1]] * 3 + [[1, 1, 1, 1]])).tolist(),
        "mirrored": lambda m: (m * [-1, 1, 1, 1]).tolist(),
        "transposed": lambda m: m.T.tolist(),  # a file written column by column: its rotation is still one
        "3 x 4": lambda m: m[:3].tolist(),
        "ragged": lambda m: [[1, 2], *m.tolist()[1:]],
    }
    for name, how in matrices.items():
        yield f"matrix: {name}", turned(how), r"frames\[1\]: transform_matrix: expected"
    yield "matrix: missing", edit(TRAIN, "frames", 1, "transform_matrix", value=...), r"frames\[1\]: transform_matrix: expected"
    for key, value in INTRINSICS:
        yield f"{key}: {value}", edit(TRAIN, key, value=value), rf"{key}\b.*expected|expected {key}|focal length: expected"
    yield "no focal length", edit(TRAIN, "camera_angle_x", value=...), "expected camera_angle_x or fl_x, found neither"
    for value in ("srgb", None):
        yield f"colours: {value}", edit(SCENE, "color_space", value=value), "color_space: expected 'linear_rec709'"
    for key, value in {"up": "y", "lights": [1], "truth_textures": 3, "metallic": "yes"}.items():
        yield f"{key}: another", edit(SCENE, key, value=value), f"{key}: expected"
    for value in (None, {}, [3], []):
        yield f"frames: {value}", edit(TRAIN, "frames", value=value), "frames.*expected|needs at least one training view"
    yield "no file_path", edit(TRAIN, "frames", 1, "file_path", value=...), r"frames\[1\]: file_path"
    for file in (SCENE, TRAIN, IMAGE, TEXTURE):
        yield f"{file}: gone", gone(file), f"{file}: no such file"
    for value in (np.nan, np.inf):
        yield f"image: {value}", lossy(IMAGE, (5, 7, 1), value), f"{IMAGE}: 1 pixel.* NaN or Inf, the first at row 5, column 7"
    yield "light: NaN", lossy("lights/night.exr", (0, 0, 0), np.nan), "night.exr: 1 pixel.* NaN"
    yield "light: negative", lossy(LIGHT, (0, 0, 0), -300), f"{LIGHT}: expected radiance, found the negative value -300"
    yield "image: negative", lossy(IMAGE, (9, 9, 0), -0.25), f"{IMAGE}: expected radiance, found the negative value -0.25"
    yield "image: without alpha", exr(IMAGE, 4, lambda image: image[..., :3]), f"{IMAGE}: expected channels R, G, B, A"
    yield "image: alpha of 255", exr(IMAGE, 4, lambda image: 255 * image), f"{IMAGE}: expected alpha from 0 to 1, found "
    yield "image: another size", exr(IMAGE, 4, lambda image: image[:, :31]), f"{IMAGE}: expected w = 32, as .* found 31"
    depth = "truth/test/depth/0000.exr"
    yield "truth: another size", exr(depth, 1, lambda image: image[:16, :16]), f"{depth}: expected 32 x 32.*found 16 x 16"


CASES = list(cases())


@pytest.fixture(scope="module")
def small(tiny_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene `tiny` with two training views, one test view and two novel views; read only."""
    folder = tmp_path_factory.mktemp("small") / "scene"
    shutil.copytree(tiny_folder, folder)
    for split, chosen in (("train", (0, 1)), ("test", (0,)), ("novel", (0, -1))):
        path = folder / f"transforms_{split}.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps({**content, "frames": [content["frames"][i] for i in chosen]}))
    (folder / SCENE).write_text(json.dumps({**json.loads((folder / SCENE).read_text()), "splits": {"train": 2, "test": 1}}))
    return folder


@pytest.fixture
def scene(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("IA_BENCH_DEBUG", raising=False)
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(small, tmp_path / "scene"))


@pytest.mark.parametrize(("spoil", "says"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_a_wrong_file_is_one_sentence(scene: Path, spoil: Spoil, says: str) -> None:
    spoil(scene)
    with pytest.raises(InputError) as caught:
        read_scene(SceneConfig(path=str(scene)), ReaderConfig(), truth=True)
    said = str(caught.value)
    assert str(scene) in said
    assert re.search(says, said), said
    assert "\n" not in said
    assert len(said) < 1000


@pytest.mark.parametrize("out", ["scene", "scene/out", "scene/../scene/out", "link/out"])
def test_results_do_not_go_into_the_scene(scene: Path, out: str, capfd: pytest.CaptureFixture[str]) -> None:
    Path("link").symlink_to("scene")
    before = sorted(scene.rglob("*"))
    for command, place in ((run, f"out={out}"), (check, f"sheet={out}/a.png")):
        assert command(["reader=native", "scene.path=scene", place]) == 2
        (said,) = (line for line in capfd.readouterr().err.splitlines() if "expected a place outside of the scene's folder" in line)
        assert re.match(rf"(ia_bench|ia-bench check): {place}: ", said), said
    assert sorted(scene.rglob("*")) == before
