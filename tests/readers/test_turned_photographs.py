"""Photographs of a camera that was held upright: calibrated cameras and masks are of the stored pixels, whatever EXIF says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from calibrated_writers import write_dtu
from nerf_writers import write_nerfstudio
from PIL import Image
from written import scene_to_write

from ia_bench.readers.dtu import DtuReader
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.scenes.scene import Scene

FORMATS = {
    "nerfstudio": (write_nerfstudio, NerfstudioReader, ("images", "masks")),
    "dtu": (write_dtu, DtuReader, ("image", "mask")),
}


def tag(folder: Path, orientation: int) -> None:
    """Give every picture of the folder an EXIF orientation and leave its pixels as they are."""
    exif = Image.Exif()
    exif[0x112] = orientation
    for path in folder.iterdir():
        with Image.open(path) as file:
            file.load()
            file.save(path, exif=exif)


@pytest.mark.parametrize("orientation", [3, 6])
@pytest.mark.parametrize("tagged", ["photographs", "both"])
@pytest.mark.parametrize("name", FORMATS)
def test_an_orientation_turns_neither_photograph_nor_mask(
    tmp_path: Path, tiny: Scene, name: str, tagged: str, orientation: int
) -> None:
    write: Callable[[Path, Scene], None]
    write, reader, folders = FORMATS[name]
    write(tmp_path, scene_to_write(tiny))
    expected = reader(tmp_path).read(truth=False).train
    for folder in folders if tagged == "both" else folders[:1]:
        tag(tmp_path / folder, orientation)
    for found, view in zip(reader(tmp_path).read(truth=False).train, expected, strict=True):
        np.testing.assert_array_equal(found.image, view.image)
        np.testing.assert_array_equal(found.mask, view.mask)
