"""Lights that several native scenes share: found beside the folder of scenes, and known by their hash."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from broken_folder import edit_json, refused

from ia_bench.readers.native import NativeReader
from ia_bench.scenes.exr import read_exr, write_exr
from ia_bench.scenes.scene import Scene

SHIPPED = Path(__file__).parents[2] / "datasets" / "scenes"


@pytest.fixture
def sharing(tiny_copy: Path) -> Path:
    """A copy of ``tiny`` below a folder of scenes, whose light ``night`` lies in the folder of shared ones."""
    (tiny_copy.parent / "scenes").mkdir()
    folder = tiny_copy.rename(tiny_copy.parent / "scenes" / "tiny")
    shared = folder.parents[1] / "lights" / "any.exr"
    shared.parent.mkdir()
    (folder / "lights" / "night.exr").rename(shared)
    told = {"shared": "any.exr", "sha256": hashlib.sha256(shared.read_bytes()).hexdigest()}
    edit_json(folder / "scene.json", lambda content: content["lights"].update(night=told))
    return folder


def test_a_shared_light_is_read_from_beside_the_scenes(tiny: Scene, sharing: Path) -> None:
    scene = NativeReader(sharing).read(truth=True)
    np.testing.assert_array_equal(scene.truth.lights["night"], tiny.truth.lights["night"])


def test_a_shared_light_is_found_through_a_link_to_the_scene(tiny: Scene, sharing: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "link").symlink_to(sharing)
    scene = NativeReader(tmp_path / "elsewhere" / "link").read(truth=True)
    np.testing.assert_array_equal(scene.truth.lights["night"], tiny.truth.lights["night"])


def test_refuses_a_shared_light_that_is_not_the_one_of_the_scene(sharing: Path) -> None:
    path = sharing.parents[1] / "lights" / "any.exr"
    write_exr(path, 2 * read_exr(path, 3))
    refused(sharing, r"any\.exr: expected the light whose SHA-256 .*scene\.json: lights\.night\.sha256 tells", truth=True)
    path.unlink()
    refused(sharing, r"scene\.json: lights\.night\.shared: in .*lights: any\.exr: no such file", truth=True)


@pytest.mark.parametrize("told", [{}, {"shared": "any.exr"}, {"shared": "any.exr", "sha256": "", "more": 1}, ["any.exr"]])
def test_refuses_a_light_that_is_neither_a_path_nor_shared(sharing: Path, told: object) -> None:
    edit_json(sharing / "scene.json", lambda content: content["lights"].update(night=told))
    refused(sharing, r"scene\.json: lights\.night: expected", truth=True)


@pytest.mark.parametrize("name", ["../scenes/tiny/lights/sunset.exr", "/dev/null", 3])
def test_a_shared_light_lies_in_the_folder_of_lights(sharing: Path, name: object) -> None:
    edit_json(sharing / "scene.json", lambda content: content["lights"]["night"].update(shared=name))
    refused(sharing, r"scene\.json: lights\.night\.shared", "expected", truth=True)


@pytest.mark.parametrize("name", ["hat", "ship", "console", "figurine"])
def test_the_shipped_scenes_have_their_lights(name: str) -> None:
    lights = NativeReader(SHIPPED / name).read(truth=True).truth.lights
    assert {light: radiance.shape for light, radiance in lights.items()} == dict.fromkeys(
        ("train", "studio", "sunset", "night"), (256, 512, 3)
    )
