"""Files are whole or absent."""

from __future__ import annotations

from pathlib import Path

import pytest

from ia_bench.common.atomic_file import whole_file


def test_a_file_appears_when_its_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    path.write_text("before")
    with whole_file(path) as partial:
        assert partial.suffix == ".svg"
        partial.write_text("after")
        assert path.read_text() == "before"
    assert path.read_text() == "after"
    assert list(tmp_path.iterdir()) == [path]


def _interrupted(path: Path) -> None:
    with whole_file(path) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt


def test_what_fails_leaves_the_file_as_it_was_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    path.write_text("before")
    with pytest.raises(KeyboardInterrupt):
        _interrupted(path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
