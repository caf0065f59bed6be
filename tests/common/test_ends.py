"""Files are whole or absent, numbers and needs that make no sense are refused, and a full disk is told in one line."""

import argparse
import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import torch

from ia_bench.cli.table import parse
from ia_bench.common import machine
from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file, whole_folder
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, MISTAKE, status_of


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


def test_what_fails_leaves_the_file_as_it_was_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    path.write_text("before")
    with suppress(KeyboardInterrupt), whole_file(path) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
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


def test_a_share_that_cannot_write_down_an_entry_still_keeps_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_cifs(descriptor: int, plain: Callable[[int], None] = os.fsync) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        plain(descriptor)

    monkeypatch.setattr(os, "fsync", as_cifs)
    with whole_file(tmp_path / "figure.svg") as partial:
        partial.write_text("whole")
    assert (tmp_path / "figure.svg").read_text() == "whole"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "report.md"), "[Errno 28] No space left on device: 'report.md'"),
        (FloatingPointError("step 10: the loss is NaN"), "step 10: the loss is NaN"),
    ],
)
def test_a_full_disk_and_numbers_that_are_none_are_told(error: Exception, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise error

    assert status_of(work) == FAULT
    assert capsys.readouterr().err == f"ia_bench: {said}\n"


def test_a_name_that_no_file_can_have_is_a_mistake_in_a_short_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for name, why in (("x" * 3000, "File name too long"), ("loop", "Too many levels of symbolic links")):
        assert status_of(lambda name=name: len((tmp_path / name).read_bytes())) == MISTAKE
        said = capsys.readouterr().err
        assert said.endswith(f": expected the name of a file or folder, found: {why}\n")
        assert len(said) < 600


SPOILS = {
    "closed": "sys.stdout.close(); sys.stderr.close()",
    "descriptors": "os.close(1); os.close(2)",
    "led elsewhere": "sys.stdout = open(os.devnull, 'w'); os.dup2(sys.stdout.fileno(), 1)",
    "taken apart": "sys.stdout.detach()",
    "none": "sys.stdout = None",
}
SPOILED = """
import os, sys
from ia_bench.common.exit_codes import say
from ia_bench.common.progress import Progress
from ia_bench.common.registry import at_work
progress = Progress()
for name in sys.argv[1:]:
    with at_work("prior", "mine"):
        exec(name)
    say(name, sys.stdout)
    progress.note(name)
"""


def test_a_plugin_that_spoils_standard_output_does_not_silence_what_comes_after() -> None:
    ended = subprocess.run([sys.executable, "-c", SPOILED, *SPOILS.values()], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout.splitlines(), ended.stderr.splitlines()) == (0, [*SPOILS.values()], [*SPOILS.values()])


@pytest.mark.parametrize(
    ("quota", "expected"), [(None, 8), ("max 100000", 8), ("250000 100000", 2), ("50000 100000", 1), ("6400000 100000", 8)]
)
def test_cores_are_those_of_a_container(quota: str | None, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "cpu.max"
    if quota is not None:
        place.write_text(f"{quota}\n")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(machine, "QUOTA", place)
    assert machine.cores() == expected


def test_a_need_beyond_the_memory_that_is_free_is_named_with_both_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 0 < machine.available_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    # all that no other program has: 5 GB, and 1 of the 2 GB that torch holds
    for name, value in (("mem_get_info", (5e9, 8e9)), ("memory_reserved", 2e9), ("memory_allocated", 1e9)):
        monkeypatch.setattr(torch.cuda, name, lambda value=value: value)
    machine.expect_memory("render.texture=2048", 5.9e9, "cuda")
    with pytest.raises(InputError, match=r"the 6\.0 GB of memory that are free on the GPU, found a need for 6\.1 GB"):
        machine.expect_memory("render.texture=2048", 6.1e9, "cuda")
    monkeypatch.setattr(machine, "available_memory", lambda device: 8_000_000_000)
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
