"""Numbers that make no sense are refused by every command line that takes them, before any work."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ia_bench.cli.table import parse
from ia_bench.common.errors import InputError


@pytest.mark.parametrize(
    ("command", "option", "value", "least"),
    [
        (["ia_bench_training.single_view", "hat"], "--limit", "-1", 1),
        (["ia_bench_training.single_view", "hat"], "--seeds", "x", 0),
        (["benchmarks.forward_check", "tiny"], "--samples", "0", 1),
        (["benchmarks.work_precision"], "--threads", "0", 1),
        (["benchmarks.stiffness", "tiny", "--out", "nowhere"], "--bounces", "-1", 0),
    ],
)
def test_refused(command: list[str], option: str, value: str, least: int) -> None:
    ended = subprocess.run([sys.executable, "-m", *command, option, value], capture_output=True, text=True)
    assert ended.returncode == 2
    last = ended.stderr.strip().split("\n")[-1]
    assert last.endswith(f"error: argument {option}: expected a whole number of at least {least}, found {value}")
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("inner", ["launcher.cpus.x", "launcher.cpus.x.y"])
def test_a_setting_below_one_that_has_a_value_is_refused(inner: str) -> None:
    with pytest.raises(InputError, match=f"{inner}: expected a setting, found one below cpus, which is 4"):
        parse(["launcher=submitit_local", "launcher.cpus=4", f"{inner}=1"])
