"""A wrong option of a reader is told before a file is read, and the exit status tells whose mistake a wrong scene is."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from layouts import LAYOUTS
from spoils import exr
from test_mistakes import MISTAKES

from ia_bench.cli.export import main as export
from ia_bench.common.errors import InputError
from ia_bench.common.registry import create, find
from ia_bench.readers.neilf import NeilfReader
from ia_bench.readers.writers.parts import Options
from ia_bench.runs.config import ReaderConfig, SceneConfig
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.scene import Scene


@pytest.mark.parametrize("name", sorted({layout.name for layout in LAYOUTS}))
def test_a_wrong_option_is_told(name: str) -> None:
    """The types of options that readers share are known in the file of each."""
    with pytest.raises(InputError, match=r"unknown value of reader\.options\.uv: 'none'\. There are: mesh, xatlas"):
        create("reader", name, find("reader", name).target, {"uv": "none"}, None)


def test_photographs_that_would_all_be_fitted_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"reader\.options\.every: expected 1000 or less, found 1000000000"):
        create("reader", "nerfstudio", find("reader", "nerfstudio").target, {"every": 10**9}, tmp_path)


def test_a_light_that_is_called_by_a_number_needs_no_quotes(tmp_path: Path) -> None:
    """reader.options.rotation=120, as the documents have it, is a number by the time that a reader is made."""
    for rotation, name in ((120, "120"), (0, "000"), ("060", "060")):
        reader = create("reader", "tensoir", find("reader", "tensoir").target, {"rotation": rotation}, tmp_path)
        assert reader.photographs[0] == f"rgba_sunset_{name}.png"


class Theirs(NeilfReader):
    """The reader of somebody else, whose mistake it is what he hands on."""

    def read(self, truth: bool) -> Scene:
        scene = super().read(truth)
        camera = replace(scene.train[0].camera, focal=(1e300, 1e300))
        return replace(scene, train=(replace(scene.train[0], camera=camera), *scene.train[1:]))


def test_a_wrong_file_is_the_users_mistake_and_a_wrong_scene_the_readers(
    written: dict[str, tuple[Path, Options]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Which the exit status tells."""
    folder = Path(shutil.copytree(written["neilf"][0], tmp_path / "tiny"))
    settings = [f"scene.path={folder}", str(tmp_path / "out"), "--format", "native", "device=cpu"]
    assert export([f"reader={Theirs.__module__}:{Theirs.__name__}", *settings]) == 1
    expected = f"reader={Theirs.__module__}:Theirs: neilf {folder}: train view 000: camera: focal: expected 2 numbers"
    assert expected in capsys.readouterr().err
    MISTAKES["neilf"]["focal length beyond"][0](folder)
    assert export(["reader=neilf", *settings]) == 2
    assert f"ia_bench: {folder}/inputs/sfm_scene.json: camera_track_map.images.3.camera" in capsys.readouterr().err


def test_what_a_built_in_reader_may_not_give_is_the_users_mistake(written: dict[str, tuple[Path, Options]], tmp_path: Path) -> None:
    """Which the reader itself had not noticed."""
    folder = Path(shutil.copytree(written["neilf"][0], tmp_path / "tiny"))
    exr("inputs/images/003.exr", 3, lambda image: image * np.float32(1e30))(folder)
    reader = ReaderConfig("neilf", find("reader", "neilf").target, written["neilf"][1])
    with pytest.raises(InputError, match="test view 003: image: expected finite values from 0 to 1e") as caught:
        read_scene(SceneConfig(path=str(folder)), reader, truth=True)
    assert type(caught.value) is InputError
