"""What the recipes write: rounded numbers, image files, scene folders, and the mesh."""

import errno
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from recipe_modules import NOVEL_LIGHTS, ROOT, exr, mesh, recipe, scene_folder, share_lights, staging


# -- rounding ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("bits", [6, 8, 10])
def test_rounding_error_is_bounded_and_nearest(bits: int) -> None:
    rng = np.random.default_rng(0)
    values = (rng.choice([-1, 1], 50_000) * 2.0 ** rng.uniform(-14, 15.9, 50_000)).astype(np.float32)
    rounded = exr.round_mantissa(values, bits)
    error = np.abs(rounded.astype(np.float64) - values)
    assert (error <= 2.0 ** -(bits + 1) * np.abs(values)).all()
    # Independent: round the significand that frexp gives, half to even.
    significand, exponent = np.frexp(values.astype(np.float64))
    np.testing.assert_array_equal(
        rounded.astype(np.float64), np.ldexp(np.rint(significand * 2 ** (bits + 1)) / 2 ** (bits + 1), exponent)
    )
    half = 2.0 ** (14 - bits)  # of the last step below 2^16, from which on a value is rounded to what no half float can be
    assert exr.round_mantissa(np.array([2**16 - 1.01 * half]), bits) == 2**16 - 2 * half
    with pytest.raises(ValueError, match="at most 65504"):
        exr.round_mantissa(np.array([1.0, half - 2**16]), bits)


def test_normals_are_stored_in_absolute_steps() -> None:
    normal = np.random.default_rng(3).normal(size=(500, 1, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    stored = exr.quantise(normal.astype(np.float32), exr.STORAGE["normal"]).astype(np.float64)
    np.testing.assert_array_equal(stored * 256, np.rint(stored * 256))
    assert np.abs(stored - normal).max() <= 1 / 512 + 1e-7


@pytest.mark.parametrize(("kind", "decibels"), [("image", 45.0), ("specular", 45.0), ("train_specular", 40.0)])
def test_lossy_kinds_keep_their_promise(tmp_path: Path, kind: str, decibels: float) -> None:
    """A shaded ball with texture, highlight and a hard edge: PSNR of gamma-encoded values; alpha is only rounded."""
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 96), np.linspace(-1.1, 1.1, 96))
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    paint = 0.4 + 0.2 * np.sin(9 * x) * np.sin(7 * y) + np.random.default_rng(4).normal(0, 0.02, x.shape)
    shade = inside * (paint * np.maximum(0.3 * x + 0.9 * z, 0) + 2 * np.maximum(0.6 * x + 0.8 * z, 0) ** 60)
    image = np.stack([shade, 0.8 * shade, 0.5 * shade, inside], axis=-1)[..., : 4 if kind == "image" else 3]
    exr.store(tmp_path / "image.exr", image, kind)
    planes = exr.read_planes(tmp_path / "image.exr")
    found = np.stack([planes[c] for c in "RGB"], axis=-1).astype(np.float64)
    error = np.clip(found, 0, 1)[inside] ** (1 / 2.2) - np.clip(image[..., :3], 0, 1)[inside] ** (1 / 2.2)
    assert -10 * np.log10(np.mean(error**2)) > decibels
    if kind == "image":
        np.testing.assert_array_equal(planes["A"], image[..., 3])


def test_exr_round_trip(tmp_path: Path) -> None:
    image = exr.round_mantissa(np.random.default_rng(1).uniform(0, 2, (31, 37, 4)), 7)
    exr.write_exr(tmp_path / "deep" / "image.exr", image)
    planes = exr.read_planes(tmp_path / "deep" / "image.exr")
    np.testing.assert_array_equal(np.stack([planes[c] for c in "RGBA"], axis=-1), image)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["image.exr"]  # no temporary file stays
    with pytest.raises(ValueError, match=r"expected a half image .* got float32"):
        exr.write_exr(tmp_path / "image.exr", np.zeros((3, 4, 3), np.float32))


# -- scene folder ------------------------------------------------------------------------------------------------------
def test_every_view_has_its_own_files_and_only_test_has_all_truth() -> None:
    views = scene_folder.views(recipe.RECIPES["hat"])
    assert len(views) == 100 + 20 + 20 * 4 + 4
    files = [path for view in views for path in view.files]
    assert len(set(files)) == len(files) == 100 * 2 + 20 * 6 + 80 + 4
    assert {v.light for v in views if v.split == "novel"} == {"train", *NOVEL_LIGHTS}
    assert all(v.light == "train" for v in views if v.split != "novel")
    direct, test = ([v for v in views if v.split == split] for split in ("direct", "test"))
    assert [v.image for v in direct] == [f"direct/test/{index:04d}.exr" for index in (0, 5, 10, 15)]
    assert all((v.pose == test[v.index].pose).all() for v in direct)


# -- lights that scenes share ------------------------------------------------------------------------------------------
def scenes_with_lights(root: Path, **lights: dict[str, bytes]) -> list[Path]:
    """Folders with a scene.json and the given bytes as lights."""
    for scene, held in lights.items():
        (root / "scenes" / scene / "lights").mkdir(parents=True)
        for name, content in held.items():
            (root / "scenes" / scene / "lights" / f"{name}.exr").write_bytes(content)
        scene_folder.write_json(root / "scenes" / scene / "scene.json", {"lights": {name: f"lights/{name}.exr" for name in held}})
    return [root / "scenes" / scene for scene in lights]


def test_lights_that_all_scenes_hold_alike_are_stored_once(tmp_path: Path) -> None:
    scenes = scenes_with_lights(
        tmp_path, a={"train": b"1", "night": b"3", "dusk": b"4"}, b={"train": b"2", "night": b"3"}, c={"train": b"2", "night": b"3"}
    )
    assert share_lights.share(scenes) == [tmp_path / "lights" / "night.exr"]
    told = {"shared": "night.exr", "sha256": "4e07408562bedb8b60ce05c1decfe3ad16b72230967de01f640b7e4729b49fce"}  # sha256sum of "3"
    found = [json.loads((scene / "scene.json").read_text())["lights"] for scene in scenes]
    assert [lights["night"] for lights in found] == [told] * 3
    assert found[0]["train"] == "lights/train.exr"
    files = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.exr"))
    assert files == ["lights/night.exr", "scenes/a/lights/dusk.exr", *(f"scenes/{scene}/lights/train.exr" for scene in "abc")]
    assert share_lights.share(scenes) == []  # nothing is left to share


# -- staging -----------------------------------------------------------------------------------------------------------
def test_a_finished_render_replaces_the_scene_and_leaves_nothing_else(tmp_path: Path) -> None:
    out, hat = tmp_path / "hat", recipe.RECIPES["hat"]
    (out / "images").mkdir(parents=True)
    (out / "images" / "old.exr").touch()
    folder = staging.begin(out, hat)
    assert staging.begin(out, hat) == folder  # resumed
    for name in ("new.exr", ".new.123.exr", ".lock"):
        (folder / name).touch()
    assert (out / "images" / "old.exr").exists()  # untouched until the new one is complete
    staging.publish(folder, out)
    assert [path.name for path in tmp_path.rglob("*")] == ["hat", "new.exr"]


def test_an_unfinished_render_of_something_else_is_refused(tmp_path: Path) -> None:
    staging.begin(tmp_path / "hat", recipe.RECIPES["hat"])
    with pytest.raises(ValueError, match=r"unfinished render with texture_size 512, size 128|unfinished render with size 128"):
        staging.begin(tmp_path / "hat", recipe.RECIPES["hat"].at_size(512))
    staging.begin(tmp_path / "ship", recipe.RECIPES["hat"].at_size(512))  # another place is free
    assert [path.name for path in staging.staging_folder(tmp_path / "hat").iterdir()] == [staging.JOB]


def test_a_run_that_cannot_say_what_it_renders_leaves_the_place_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a full disk does it, or a run that is killed while another one begins: half a file would stop all runs that follow."""

    def half(path: Path, text: str, write: Callable[[Path, str], int] = Path.write_text) -> None:
        write(path, text[: len(text) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(Path, "write_text", half)
        with pytest.raises(OSError, match="No space"):
            staging.begin(tmp_path / "hat", recipe.RECIPES["hat"])
    staging.begin(tmp_path / "hat", recipe.RECIPES["hat"])


def make_scenes(*settings: str) -> list[list[str]]:
    """What `make scenes` would run for each scene, as arguments of render_scene.py; nothing is run."""
    printed = subprocess.run(
        ["make", "-n", "scenes", *settings], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.replace("\\\n", "")
    (loop,) = (line for line in printed.splitlines() if "render_scene.py" in line)
    listed, _, command = loop.removeprefix("for scene in ").partition("; do")
    arguments = command.split("render_scene.py")[1].split("||")[0]
    return [arguments.replace("$scene", name).split() for name in listed.split()]


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_scenes_leaves_the_shipped_scenes_alone() -> None:
    four = ("hat", "ship", "console", "figurine")
    assert make_scenes() == [[name, "--out", f"results/datasets/scenes/{name}"] for name in four]
    assert make_scenes("SIZE=512") == [[name, "--size", "512", "--out", f"results/datasets-512/scenes/{name}"] for name in four]
    assert make_scenes("SCENES=tiny") == [["tiny", "--out", "results/datasets/scenes/tiny"]]  # at its own size
    four = ("book", "fruit", "bear", "drum")
    assert make_scenes("SCENES=value") == [[name, "--out", f"results/datasets/scenes/{name}"] for name in four]
    assert make_scenes("SCENES=hat", "DATASETS=elsewhere") == [["hat", "--out", "elsewhere/scenes/hat"]]


# -- mesh --------------------------------------------------------------------------------------------------------------
def test_ply_round_trip(tmp_path: Path) -> None:
    """Also through trimesh, which knows nothing of this writer."""
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(50, 8)).astype(np.float32)
    faces = rng.permuted(np.tile(np.arange(50, dtype=np.int32), (40, 1)), axis=1)[:, :3]
    written = mesh.Mesh(corners[:, :3], corners[:, 3:6], corners[:, 6:], faces)
    mesh.write_ply(tmp_path / "mesh.ply", written)
    read = mesh.read_ply(tmp_path / "mesh.ply")
    for name in ("positions", "normals", "uv", "faces"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    other = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(other.vertices[other.faces], corners[faces, :3])  # it may number vertices otherwise
    with pytest.raises(ValueError, match="at most 65536 vertices, got 65537"):
        mesh.write_ply(tmp_path / "mesh.ply", mesh.Mesh(*(np.zeros((65537, n), np.float32) for n in (3, 3, 2)), faces))
