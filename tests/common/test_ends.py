"""Files are whole or absent, numbers and needs that make no sense are refused, and a full disk is told in one line."""

import argparse
import errno
import os
from contextlib import suppress
from pathlib import Path

import pytest

from ia_bench.cli.table import parse
from ia_bench.common import machine
from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file, whole_folder
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, status_of


def test_a_file_appears_when_its_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    path.write_text("before")
    with whole_file(path) as partial:
        assert partial.suffix == ".svg"
        partial.write_text("after")
        assert path.read_text() == "before"
        with whole_file(path) as other:  # of a process on another machine, which may have the same number
            other.write_text("between")
        assert path.read_text() == "between"
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


def test_a_folder_appears_when_its_block_ends(tmp_path: Path) -> None:
    (tmp_path / "usual").mkdir()
    (tmp_path / "empty").mkdir()
    for name in ("new", "empty"):
        before = sorted(tmp_path.rglob("*"))
        with suppress(KeyboardInterrupt), whole_folder(tmp_path / name) as place:
            (place / "half").mkdir()
            raise KeyboardInterrupt
        assert sorted(tmp_path.rglob("*")) == before
        with whole_folder(tmp_path / name) as place:
            (place / "file").write_text("whole")
        assert sorted(tmp_path.rglob("*")) == sorted({*before, tmp_path / name, tmp_path / name / "file"})
        assert (tmp_path / name).stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "report.md"), "[Errno 28] No space left on device: 'report.md'"),
        (FloatingPointError("step 10: the loss is NaN"), "step 10: the loss is NaN"),
    ],
)
def test_a_full_disk_and_numbers_that_are_none_are_told_in_one_line(
    error: Exception, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> int:
        raise error

    assert status_of(work) == FAULT
    assert capsys.readouterr().err == f"ia_bench: {said}\n"


def test_available_memory_is_some_and_no_more_than_there_is() -> None:
    assert 0 < machine.available_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def test_a_need_beyond_it_is_named_with_both_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "available_memory", lambda: 8_000_000_000)
    machine.expect_memory("render.texture=2048", 5e8)
    with pytest.raises(InputError, match=r"render\.texture=100000: expected .* the 8\.0 GB .*, found a need for 1\.28e\+03 GB"):
        machine.expect_memory("render.texture=100000", 1.28e12)


@pytest.mark.parametrize(("value", "least"), [("-1", 1), ("x", 0), ("0", 1), ("-1", 0), ("1.5", 1)])
def test_a_number_that_is_too_small_or_none_is_refused(value: str, least: int, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=at_least(least))
    with pytest.raises(SystemExit):
        parser.parse_args(["--seeds", value])
    said = capsys.readouterr().err.strip().split("\n")[-1]
    assert said.endswith(f"error: argument --seeds: expected a whole number of at least {least}, found {value}")
    assert parser.parse_args(["--seeds", str(least)]).seeds == least


@pytest.mark.parametrize("inner", ["launcher.cpus.x", "launcher.cpus.x.y"])
def test_a_setting_below_one_that_has_a_value_is_refused(inner: str) -> None:
    with pytest.raises(InputError, match=f"{inner}: expected a setting, found one below cpus, which is 4"):
        parse(["launcher=submitit_local", "launcher.cpus=4", f"{inner}=1"])
