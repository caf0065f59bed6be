"""Masks that nerfstudio's reader finds by the name of a photograph: beside photographs of two cameras, and of one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from nerf_writers import write_nerfstudio
from written import STEP, scene_to_write, unlit

from ia_bench.common.errors import InputError
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.scenes.scene import Scene


@pytest.fixture
def folder(tmp_path: Path, tiny: Scene) -> Path:
    """The scene `tiny` as of two cameras: images/left/NNNN.png with masks/left/NNNN.png, and the same of images/right."""
    write_nerfstudio(tmp_path, scene_to_write(tiny))
    content = json.loads((tmp_path / "transforms.json").read_text())
    for place, frame in enumerate(content["frames"]):
        name = f"{('left', 'right')[place % 2]}/{place // 2:04}.png"
        for kind, path in (("images", frame["file_path"]), ("masks", frame.pop("mask_path"))):
            (tmp_path / kind / name).parent.mkdir(exist_ok=True)
            (tmp_path / path).rename(tmp_path / kind / name)
        frame["file_path"] = f"./images/{name}"
    paths = [frame["file_path"] for frame in content["frames"]]
    count = len(content["train_filenames"])
    content.update(train_filenames=paths[:count], test_filenames=paths[count:])
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path


def test_masks_lie_in_folders_like_those_of_the_photographs(folder: Path, tiny: Scene) -> None:
    scene, expected = NerfstudioReader(folder).read(truth=False), unlit(scene_to_write(tiny))
    assert scene.train[1].name == "images/right/0000"
    for split in ("train", "test"):
        for view, one in zip(getattr(scene, split), getattr(expected, split), strict=True):
            assert np.abs(view.mask - one.mask).max() <= STEP + 1e-6


def test_one_mask_is_of_one_photograph(folder: Path) -> None:
    for path in (folder / "masks" / "left").iterdir():
        path.rename(folder / "masks" / path.name)
    NerfstudioReader(folder).read(truth=False)  # those of the other camera have masks of their own
    for path in (folder / "masks" / "right").iterdir():
        path.unlink()
    with pytest.raises(InputError, match=r"masks/0000\.png: .* images/left/0000\.png and images/right/0000\.png would share it"):
        NerfstudioReader(folder).read(truth=False)


@pytest.mark.parametrize("name", [None, "0001.jpg", "0001.tif"])
def test_a_mask_that_is_missing_is_named(folder: Path, name: str | None) -> None:
    """Also where it is there under another suffix."""
    mask = folder / "masks" / "right" / "0001.png"
    if name is None:
        mask.unlink()
        said = ""
    else:
        mask.rename(mask.with_name(name))
        said = f"; {name}, which lies there, is no .png file"
    with pytest.raises(InputError) as error:
        NerfstudioReader(folder).read(truth=False)
    assert str(error.value).startswith(f"{folder / 'images' / 'right' / '0001.png'}: expected a mask")
    assert str(error.value).endswith(f"found an opaque picture and no {mask}{said}")


def test_a_folder_may_be_read_twice(folder: Path) -> None:
    """The second reading does not take the masks of the first for those of other photographs."""
    reader = NerfstudioReader(folder)
    assert len(reader.read(truth=False).test) == len(reader.read(truth=True).test) > 0


def test_a_photograph_is_not_its_own_mask(folder: Path) -> None:
    """A path with .. in it leads to photographs, but not from the folder of masks to them."""
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        frame["file_path"] = frame["file_path"].replace("./images", "masks/../images")
    del content["train_filenames"], content["test_filenames"]
    (folder / "transforms.json").write_text(json.dumps(content))
    train = NerfstudioReader(folder).read(truth=False).train
    assert min(view.mask.min() for view in train) == 0
