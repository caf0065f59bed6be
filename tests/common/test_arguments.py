"""Numbers that make no sense are refused by every command line that takes them, before any work."""

from __future__ import annotations

import argparse

import pytest

from ia_bench.cli.table import parse
from ia_bench.common.arguments import at_least
from ia_bench.common.errors import InputError


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
