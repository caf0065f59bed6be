"""Photographs whose suffix a camera wrote in upper case are photographs."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.readers.pictures import picture_below, pictures_in


@pytest.mark.parametrize("suffix", [".PNG", ".JPG", ".JPEG", ".TIF", ".png", ".jpg", ".WebP"])
def test_the_case_of_a_suffix_does_not_matter_in_a_list(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "notes.TXT").write_text("no picture")
    Image.new("RGB", (2, 2)).save(tmp_path / f"a{suffix}")
    Image.new("RGB", (2, 2)).save(tmp_path / "b.png")
    assert [path.name for path in pictures_in(tmp_path)] == [f"a{suffix}", "b.png"]


@pytest.mark.parametrize("suffix", [".PNG", ".JPG", ".JPEG", ".TIF", ".png", ".jpg", ".tiff"])
def test_a_name_without_its_suffix_is_found(tmp_path: Path, suffix: str) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / f"a{suffix}")
    assert picture_below(tmp_path, "a", "here").name == f"a{suffix}"
    assert picture_below(tmp_path, f"a{suffix}", "here").name == f"a{suffix}"
    with pytest.raises(InputError, match="here: b: no such file"):
        picture_below(tmp_path, "b", "here")
