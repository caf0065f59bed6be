"""Which frames of transforms.json are for training and which are held out, and paths that lead to the folder by another way."""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layouts import scene_to_write
from PIL import Image
from spoils import edited

from ia_bench.common.errors import InputError
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.readers.writers.frames import write_blender, write_nerfstudio
from ia_bench.scenes.scene import Scene

WHOLE, TRAIN, VAL, TEST = "transforms.json", "train_filenames", "val_filenames", "test_filenames"


@pytest.fixture
def folder(tmp_path: Path, tiny: Scene) -> Path:
    """The scene `tiny` as nerfstudio has it, below a folder of its own."""
    write_nerfstudio(tmp_path / "tiny", scene_to_write(tiny))
    return tmp_path / "tiny"


def names(folder: Path, split: str) -> list[str]:
    return [f"{view.name}.png" for view in getattr(NerfstudioReader(folder).read(truth=False), split)]


@pytest.mark.parametrize("kept", [TEST, VAL])
def test_all_that_is_not_held_out_is_for_training(folder: Path, kept: str) -> None:
    def only(content: dict[str, Any]) -> None:
        del content[TRAIN]
        content[kept] = content.pop(TEST)

    content = edited(WHOLE, only)(folder)
    assert names(folder, "test") == content[kept]
    everything = [frame["file_path"] for frame in content["frames"]]
    assert names(folder, "train") == [name for name in everything if name not in content[kept]]


def test_validation_frames_are_not_trained_on_where_test_frames_are_held_out(folder: Path) -> None:
    def both(content: dict[str, Any]) -> None:
        content[VAL] = content.pop(TRAIN)[:2]

    content = edited(WHOLE, both)(folder)
    assert not set(names(folder, "train")) & {*content[VAL], *content[TEST]}
    assert names(folder, "test") == content[TEST]


@pytest.mark.parametrize("named", [False, True])
def test_a_single_photograph_is_fitted(folder: Path, named: bool) -> None:
    def one(content: dict[str, Any]) -> None:
        for split in (TRAIN, TEST):
            del content[split]
        if named:
            content[TRAIN] = [content["frames"][2]["file_path"]]
        else:
            del content["frames"][1:]

    content = edited(WHOLE, one)(folder)
    assert names(folder, "train") == [content["frames"][2 if named else 0]["file_path"]]
    assert names(folder, "test") == []


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as error:
        NerfstudioReader(folder).read(truth=False)
    return str(error.value)


def test_a_frame_in_training_and_test_is_refused(folder: Path) -> None:
    content = edited(WHOLE, lambda c: c[TEST].append(f"./{c[TRAIN][3]}"))(folder)
    assert f"test_filenames: expected every photograph once, found '{content[TRAIN][3]}' again, as in" in refused(folder)


def test_a_photograph_in_two_files_of_frames_is_refused(tmp_path: Path, tiny: Scene) -> None:
    write_blender(tmp_path, scene_to_write(tiny))
    first = json.loads((tmp_path / "transforms_train.json").read_text())["frames"][0]
    edited("transforms_test.json", lambda c: c["frames"].append(first))(tmp_path)
    assert "transforms_train.json: frames[0]: file_path" in refused(tmp_path)


def test_a_photograph_by_two_names_is_refused(tmp_path: Path, tiny: Scene) -> None:
    """With its suffix and without, and by a way that leads out of the folder and back."""
    write_nerfstudio(tmp_path / "tiny", scene_to_write(tiny))
    content = json.loads((tmp_path / "tiny" / WHOLE).read_text())
    name = content["frames"][0]["file_path"]
    for other in (name.removesuffix(".png"), f"../tiny/{name}"):
        twice = {**content, TEST: [other], "frames": [*content["frames"], {**content["frames"][0], "file_path": other}]}
        (tmp_path / "tiny" / WHOLE).write_text(json.dumps(twice))
        assert f"expected every photograph once, found {name.removesuffix('.png')!r} again" in refused(tmp_path / "tiny")


def test_a_path_that_leads_out_of_the_folder_and_back_is_no_name(folder: Path) -> None:
    expected = names(folder, "train")
    edited(WHOLE, lambda c: [frame.update(file_path=f"../tiny/{frame['file_path']}") for frame in c["frames"]])(folder)
    edited(WHOLE, lambda c: c.update({split: [f"../tiny/{name}" for name in c[split]] for split in (TRAIN, TEST)}))(folder)
    assert names(folder, "train") == expected


def test_an_absolute_path_through_a_link_leads_to_the_same_photograph(folder: Path) -> None:
    expected = names(folder, "train")
    link = folder.parent / "link"
    link.symlink_to(folder)

    def absolute(content: dict[str, Any]) -> None:
        for frame in content["frames"]:
            frame["file_path"] = str(link / frame["file_path"])
        for split in (TRAIN, TEST):
            content[split] = [str(link / name) for name in content[split]]

    edited(WHOLE, absolute)(folder)
    assert names(folder, "train") == expected


def test_frames_that_say_their_sizes_may_differ_in_them(folder: Path) -> None:
    """Upright and level photographs of one camera, with its focal length for all, and the middles as principal points."""
    content = json.loads((folder / WHOLE).read_text())
    first = content["frames"][0]["file_path"], content["frames"][0]["mask_path"]
    for name in first:
        with Image.open(folder / name) as picture:
            picture.crop((2, 0, picture.width - 2, picture.height)).save(folder / name)
    width, height = content["w"], content["h"]

    def own(content: dict[str, Any]) -> None:
        for key in ("w", "h", "cx", "cy"):
            content.pop(key, None)
        for frame in content["frames"]:
            frame.update(w=width - 4 * (frame["file_path"] == first[0]), h=height)

    edited(WHOLE, own)(folder)
    views = NerfstudioReader(folder).read(truth=False).train
    assert [view.camera.centre for view in views[:2]] == [(width / 2 - 2, height / 2), (width / 2, height / 2)]
    edited(WHOLE, lambda c: [frame.pop("w") for frame in c["frames"]])(folder)
    assert "with the same intrinsics" in refused(folder)


def test_a_frame_s_own_focal_length_counts_before_that_of_the_file(folder: Path) -> None:
    """In whichever way either is said; the file says fl_x and fl_y."""

    def own(content: dict[str, Any]) -> None:
        first, second, *_ = content["frames"]
        content["fl_x"] = content["fl_y"] = 30.0
        first["camera_angle_x"], second["fl_x"] = np.pi / 2, 50.0

    edited(WHOLE, own)(folder)
    first, second, third, *_ = NerfstudioReader(folder).read(truth=False).train
    half = first.camera.width / 2  # what a right angle sees is as far away as the focal length is long
    assert first.camera.focal == pytest.approx((half, half))
    assert (second.camera.focal, third.camera.focal) == ((50.0, 50.0), (30.0, 30.0))


def test_one_focal_length_of_rows_beside_several_of_columns(folder: Path) -> None:
    """As the writer has it, too, which says at the top what is alike in all frames."""

    def own(content: dict[str, Any]) -> None:
        content.pop("fl_x", None)
        content["fl_y"] = 52.0
        for number, frame in enumerate(content["frames"]):
            frame["fl_x"] = 50.0 + number

    edited(WHOLE, own)(folder)
    assert [view.camera.focal for view in NerfstudioReader(folder).read(truth=False).train[:2]] == [(50.0, 52.0), (51.0, 52.0)]


@pytest.mark.parametrize("place", ["masks/train", "masks/images/train", "masks"])
def test_photographs_of_one_name_have_masks_of_their_own(folder: Path, place: str) -> None:
    """In either of two places below folders of their own; one for both would be the wrong one of one of them."""

    def apart(content: dict[str, Any]) -> None:
        for split in (TRAIN, TEST):
            for number, name in enumerate(content[split]):
                frame = next(one for one in content["frames"] if one["file_path"] == name)
                here = place.replace("train", split[: -len("_filenames")])
                for path, old in ((f"images/{split[:-10]}/{number}.png", name), (f"{here}/{number}.png", frame.pop("mask_path"))):
                    (folder / path).parent.mkdir(parents=True, exist_ok=True)
                    (folder / old).rename(folder / path)
                frame["file_path"] = content[split][number] = f"images/{split[:-10]}/{number}.png"

    wanted = NerfstudioReader(folder).read(truth=False)
    edited(WHOLE, apart)(folder)
    if place == "masks":
        assert "0.png: expected the mask of one photograph, found it for images/train/0.png and images/test/0" in refused(folder)
        return
    found = NerfstudioReader(folder).read(truth=False)
    for split in ("train", "test"):
        for ours, theirs in zip(getattr(found, split), getattr(wanted, split), strict=True):
            np.testing.assert_array_equal(ours.mask, theirs.mask)


def test_photographs_do_not_pile_up_at_their_full_size(tmp_path: Path) -> None:
    """Each with a focal length of its own, as apps of phones write it, and made smaller one by one."""
    photo, frames, count = np.full((256, 256, 4), 255, np.uint8), [], 16
    photo[:9, :, 3] = 0
    for number in range(count):
        Image.fromarray(photo).save(tmp_path / f"{number}.png")
        frames.append({"file_path": f"{number}.png", "fl_x": 300.0 + number, "transform_matrix": np.eye(4).tolist()})
    (tmp_path / WHOLE).write_text(json.dumps({"frames": frames}))
    tracemalloc.start()
    NerfstudioReader(tmp_path, shrink=8).read(truth=False)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 0.5 * count * 4 * photo.size
