"""Masks that are 1 and not white where the object is, as segmentation programs write labels, are refused by name and cause."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from nerf_writers import write_nerfstudio
from PIL import Image
from spoiled import edit
from written import save_png, scene_to_write

from ia_bench.common.errors import InputError
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.readers.pictures import tone_mapped
from ia_bench.scenes.photograph import read_mask
from ia_bench.scenes.scene import Scene

INSIDE = np.zeros((6, 9), np.uint8)
INSIDE[2:5, 3:7] = 1


@pytest.mark.parametrize("lens", [False, True])
def test_labels_are_no_mask(tmp_path: Path, tiny: Scene, lens: bool) -> None:
    write_nerfstudio(tmp_path, scene_to_write(tiny))
    for path in (tmp_path / "masks").iterdir():
        with Image.open(path) as file:
            white = np.asarray(file) > 127
        Image.fromarray(white.astype(np.uint8)).save(path)
    if lens:
        edit("transforms.json", lambda content: content.update(k1=-0.05))(tmp_path)
    said = r"masks/train_\w+\.png: expected white \(255\) where the object is, found values up to 1 of 255$"
    with pytest.raises(InputError, match=said):
        NerfstudioReader(tmp_path).read(truth=False)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (INSIDE * 3, "expected white (255) where the object is, found values up to 3 of 255"),
        (INSIDE.astype(np.uint16) * 255, "expected white (65535) where the object is, found values up to 255 of 65535"),
    ],
    ids=["8 bits", "16 bits"],
)
def test_a_mask_for_another_tone_curve_is_white_too(tmp_path: Path, values: np.ndarray, said: str) -> None:
    save_png(tmp_path / "photo.png", np.full((6, 9, 3), 0.4))
    Image.fromarray(values).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'mask.png'}: {said}")):
        tone_mapped(tmp_path / "photo.png", tmp_path / "mask.png", lambda stored: stored)


def test_masks_with_edges_of_grey_and_of_one_bit_are_masks(tmp_path: Path) -> None:
    soft = INSIDE * np.linspace(20, 255, 9).astype(np.uint8)
    Image.fromarray(soft).save(tmp_path / "soft.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "soft.png"), soft / np.float32(255))
    Image.fromarray(INSIDE > 0).save(tmp_path / "bit.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "bit.png"), INSIDE)
    Image.fromarray(0 * INSIDE).save(tmp_path / "empty.png")
    assert read_mask(tmp_path / "empty.png").max() == 0
