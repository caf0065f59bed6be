"""Commands that are interrupted or started twice; spoiled checkpoints and outputs that nobody takes."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import call, command, results, started

pytestmark = pytest.mark.usefixtures("workplace")


HELD = {"FAKE_HOLD": "released"}
"""A run that waits in its middle until it is told to end."""


def until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 1200
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def numbers(name: str) -> dict:
    return json.loads(Path(name, "metrics.json").read_text())


def interrupted(number: int, *arguments: str) -> tuple[int, str]:
    """Exit status and stderr of a run that gets a signal after its first checkpoint, or when it has begun if it is stuck."""
    process = subprocess.Popen(command("out=stopped", *arguments), env=os.environ | HELD, stderr=subprocess.PIPE, text=True)
    until(lambda: bool(started()) if "row=stuck" in arguments else Path("stopped/checkpoint.pt").exists())
    process.send_signal(number)
    said = process.communicate(timeout=1200)[1]
    return process.returncode, said


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_that_is_told_to_end_saves_and_resumes_to_the_same_numbers(number: int, status: int) -> None:
    assert call("out=whole") == 0
    found, said = interrupted(number)
    assert found == status
    assert said.splitlines()[-1] == "ia_bench: interrupted; the same command resumes"
    assert "Traceback" not in said
    assert not Path("stopped/metrics.json").exists()
    assert call("out=stopped") == 0
    assert numbers("stopped") == numbers("whole")
    assert not list(Path("stopped").glob("checkpoint*"))


def test_a_run_that_does_not_come_to_save_ends_all_the_same() -> None:
    status, said = interrupted(signal.SIGTERM, "row=stuck")
    last = "ia_bench: interrupted before the run had saved anything; the same command starts over"
    assert (status, said.splitlines()[-1]) == (143, last)


def _flip(content: bytes) -> bytes:
    return content[:1200] + bytes([content[1200] ^ 4]) + content[1201:]


@pytest.mark.parametrize("spoil", [_flip, lambda content: content[:500]])
def test_a_spoiled_checkpoint_costs_time_and_no_number(spoil, capfd: pytest.CaptureFixture[str]) -> None:
    assert call("out=whole") == 0
    interrupted(signal.SIGTERM)
    path = Path("stopped/checkpoint.pt")
    path.write_bytes(spoil(path.read_bytes()))
    Path("stopped/.tmp-1-albedo.exr").write_bytes(b"half")
    Path("stopped/notes.txt").write_text("of somebody else")
    capfd.readouterr()
    assert call("out=stopped") == 0
    assert "checkpoint ignored, starting over" in capfd.readouterr().err
    assert numbers("stopped") == numbers("whole")
    names = sorted(path.name for path in Path("stopped").iterdir())
    assert names == [".lock", "config.json", "curve.csv", "metrics.json", "notes.txt"]


@pytest.mark.parametrize(
    "redirect",
    [
        "> /dev/full 2>&1",
        "| head -c 1",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("> /dev/full", ">&-", "2> /dev/full", "2>&-")),
    ],
)
def test_output_that_nobody_takes_costs_no_result(redirect: str) -> None:
    line = f"set -o pipefail; {' '.join(command())} {redirect}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert [record["status"] for record in results()] == ["ok"]


def test_two_at_once_share_one_result() -> None:
    first = subprocess.Popen(command("out=shared"), env=os.environ | HELD)
    until(Path("shared/checkpoint.pt").exists)
    second = subprocess.Popen(command("out=shared"), stderr=subprocess.PIPE, text=True)
    assert "another process is working on this run" in second.stderr.readline()
    Path("released").touch()
    assert "already finished" in second.communicate(timeout=1200)[1]
    assert (first.wait(), second.returncode, started()) == (0, 0, ["hat none 0"])
