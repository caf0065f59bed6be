"""Photographs and masks as readers open them: names, turns, which mask is whose, and what pixels betray."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layouts import STEP, scene_to_write, unlit
from PIL import Image
from spoils import edited

from ia_bench.common.errors import InputError
from ia_bench.readers.colmap import ColmapReader
from ia_bench.readers.dtu import DtuReader
from ia_bench.readers.llff import LlffReader
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.readers.pictures import mask_beside, photograph, picture_below, pictures_in
from ia_bench.readers.writers.calibrated import write_colmap, write_dtu, write_llff
from ia_bench.readers.writers.frames import write_nerfstudio
from ia_bench.scenes.photograph import read_mask
from ia_bench.scenes.scene import Scene


# ----------------------------------------------------------------
# Photographs whose suffix a camera wrote in upper case are photographs.
@pytest.mark.parametrize("suffix", [".PNG", ".JPG", ".JPEG", ".TIF", ".png", ".jpg", ".WebP"])
def test_the_case_of_a_suffix_does_not_matter_in_a_list(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "notes.TXT").write_text("no picture")
    (tmp_path / "._b.png").write_text("what macOS leaves beside b.png on other file systems")
    Image.new("RGB", (2, 2)).save(tmp_path / f"a{suffix}")
    Image.new("RGB", (2, 2)).save(tmp_path / "b.png")
    assert [path.name for path in pictures_in(tmp_path)] == [f"a{suffix}", "b.png"]


@pytest.mark.parametrize("suffix", [".PNG", ".JPG", ".tiff"])
def test_a_name_without_its_suffix_is_found(tmp_path: Path, suffix: str) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / f"a{suffix}")
    assert picture_below(tmp_path, "a", "here").name == f"a{suffix}"
    assert picture_below(tmp_path, f"a{suffix}", "here").name == f"a{suffix}"
    with pytest.raises(InputError, match="here: b: no such file"):
        picture_below(tmp_path, "b", "here")


def test_pictures_that_no_run_is_known_by_are_refused(tmp_path: Path) -> None:
    for name in ("a.png", "a.tga"):
        Image.new("RGBA", (2, 2)).save(tmp_path / name)
    for names in (["a.tga"], ["a.png", "a.tga"]):
        path, *mask = (tmp_path / name for name in names)
        with pytest.raises(InputError, match=r"a\.tga: expected a photograph or mask with one of the suffixes .*, found \.tga"):
            photograph(path, *mask or [None], [])


# ---------------------------------------------------------------- photographs of a camera that was held upright
# Calibrated cameras and masks are of the stored pixels, whatever EXIF says.
def tag(folder: Path) -> None:
    """Give every picture of the folder the EXIF orientation of a quarter turn and leave its pixels as they are."""
    exif = Image.Exif()
    exif[0x112] = 6
    for path in folder.iterdir():
        with Image.open(path) as file:
            file.load()
            file.save(path, exif=exif)


def test_an_orientation_turns_neither_photograph_nor_mask(tmp_path: Path, tiny: Scene) -> None:
    write_nerfstudio(tmp_path, scene_to_write(tiny))
    expected = NerfstudioReader(tmp_path).read(truth=False).train
    for folder in ("images", "masks"):
        tag(tmp_path / folder)
    for found, view in zip(NerfstudioReader(tmp_path).read(truth=False).train, expected, strict=True):
        np.testing.assert_array_equal(found.image, view.image)
        np.testing.assert_array_equal(found.mask, view.mask)


# ---------------------------------------------------------------- masks that nerfstudio's reader finds by the name of a photograph
# Beside photographs of two cameras, and of one.
def test_masks_lie_in_folders_like_those_of_the_photographs(tmp_path: Path, tiny: Scene) -> None:
    """The scene `tiny` as of two cameras: images/left/NNNN.png with masks/left/NNNN.png, and the same of images/right."""
    write_nerfstudio(tmp_path, scene_to_write(tiny))

    def in_two_folders(content: dict[str, Any]) -> None:
        for place, frame in enumerate(content["frames"]):
            name = f"{('left', 'right')[place % 2]}/{place // 2:04}.png"
            for kind, path in (("images", frame["file_path"]), ("masks", frame.pop("mask_path"))):
                (tmp_path / kind / name).parent.mkdir(exist_ok=True)
                (tmp_path / path).rename(tmp_path / kind / name)
            frame["file_path"] = f"./images/{name}"
        paths = [frame["file_path"] for frame in content["frames"]]
        count = len(content["train_filenames"])
        content.update(train_filenames=paths[:count], test_filenames=paths[count:])

    edited("transforms.json", in_two_folders)(tmp_path)
    scene, expected = NerfstudioReader(tmp_path).read(truth=False), unlit(scene_to_write(tiny))
    assert scene.train[1].name == "images/right/0000"
    for split in ("train", "test"):
        for view, one in zip(getattr(scene, split), getattr(expected, split), strict=True):
            assert np.abs(view.mask - one.mask).max() <= STEP + 1e-6


def test_a_mask_is_found_whose_suffix_is_in_upper_case(tmp_path: Path) -> None:
    Image.new("L", (2, 2), 255).save(tmp_path / "left.PNG")
    Image.new("L", (2, 2), 255).save(tmp_path / "right.JPG.PNG")
    assert mask_beside(tmp_path, Path("left.JPG")).name == "left.PNG"
    assert mask_beside(tmp_path, Path("right.JPG")).name == "right.JPG.PNG"


def test_a_photograph_without_a_mask_is_told_where_one_is_looked_for(tmp_path: Path, tiny: Scene) -> None:
    """As where the folder of masks was forgotten, or has another name than the option ``masks`` says."""
    scene = scene_to_write(tiny)
    for reader, write, name in (
        (NerfstudioReader, write_nerfstudio, "masks"),
        (ColmapReader, write_colmap, "masks"),
        (LlffReader, write_llff, "masks"),
        (DtuReader, write_dtu, "mask"),
    ):
        folder = tmp_path / reader.format
        folder.mkdir()
        write(folder, scene)
        if reader is NerfstudioReader:
            edited("transforms.json", lambda c: [frame.pop("mask_path") for frame in c["frames"]])(folder)
        (folder / name).rename(folder / "cutouts")
        said = rf"expected a mask in its alpha, or in a file of its own such as {folder / name}/.*\.png, found an opaque picture"
        with pytest.raises(InputError, match=said):
            reader(folder).read(truth=False)


def test_photographs_without_a_pose_are_counted(tmp_path: Path, tiny: Scene) -> None:
    """COLMAP places what it can. Masks, a second format of a photograph and what macOS hides are no photographs without a pose."""
    for reader, write in ((NerfstudioReader, write_nerfstudio), (ColmapReader, write_colmap)):
        folder = tmp_path / reader.format
        folder.mkdir()
        write(folder, scene_to_write(tiny))
        photos = sorted((folder / "images").iterdir())
        photos[0].with_suffix(".tif").write_bytes(b"")
        (folder / "images" / "._other.png").write_bytes(b"")
        assert not any("no pose" in note for note in reader(folder).read(truth=False).notes)
        for name in ("y.JPG", "z.png"):
            (folder / "images" / name).write_bytes(b"")
        told = "2 picture(s) beside the photographs have no pose and are left out, y.JPG first"
        assert told in reader(folder).read(truth=False).notes


def test_a_run_is_known_by_masks_that_lie_elsewhere(tmp_path: Path) -> None:
    for name in ("photos/images", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
        Image.new("L", (2, 2), 255).save(tmp_path / name / "a.png")
    files = NerfstudioReader(tmp_path / "photos", masks=str(tmp_path / "elsewhere")).files()
    assert files == [tmp_path / "elsewhere/a.png", tmp_path / "photos/images/a.png"]


# ---------------------------------------------------------------- masks that are 1 or a colour and not white where the object is
# As segmentation programs write labels, are refused by name and cause.
INSIDE = np.zeros((6, 9), np.uint8)
INSIDE[2:5, 3:7] = 1


def test_masks_with_edges_of_grey_and_of_one_bit_are_masks(tmp_path: Path) -> None:
    soft = INSIDE * np.linspace(20, 255, 9).astype(np.uint8)
    Image.fromarray(soft).save(tmp_path / "soft.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "soft.png"), soft / np.float32(255))
    Image.fromarray(INSIDE > 0).save(tmp_path / "bit.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "bit.png"), INSIDE)
    Image.fromarray(0 * INSIDE).save(tmp_path / "empty.png")
    assert read_mask(tmp_path / "empty.png").max() == 0


@pytest.mark.parametrize("bits", [8, 16])
def test_labels_are_no_mask(tmp_path: Path, bits: int) -> None:
    Image.fromarray(INSIDE if bits == 8 else INSIDE.astype(np.uint16) * 255).save(tmp_path / "mask.png")
    white, found = 2**bits - 1, 1 if bits == 8 else 255
    said = rf"mask\.png: expected white \({white}\) where the object is, found values up to {found} of {white}$"
    with pytest.raises(InputError, match=said):
        read_mask(tmp_path / "mask.png")


@pytest.mark.parametrize("mode", ["RGB", "P", "RGBA"])
def test_colours_of_labels_are_no_mask(tmp_path: Path, mode: str) -> None:
    """Annotation programs give each label one; of this one, .68 would be taken for the share of every pixel."""
    colours = INSIDE[..., None] * np.array([51, 221, 255], np.uint8)
    Image.fromarray(colours).convert(mode).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match=r"mask\.png: expected white \(255\) where .*, found the colour \[51, 2..?, 255\]$"):
        read_mask(tmp_path / "mask.png")
