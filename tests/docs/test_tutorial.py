"""The tutorial's prior passes the check as it says, and its table has the rows that it shows."""

import re
import sys
from pathlib import Path

import pytest
import yaml

from ia_bench.cli.main import main

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def test_its_prior_is_checked_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # to which the command adds the folder where one is
    (tmp_path / "my_prior.py").write_text(block("python"), encoding="utf-8")
    assert main(["check", "prior=my_prior:Retinex"]) == 0
    said = capfd.readouterr().out.splitlines()
    shown = [line for line in PAGE.splitlines() if line.startswith(("prior my_prior", "✓")) or line.endswith(" skipped")]
    assert len(shown) > 5
    assert not [line for line in shown if line not in said]
    rows = yaml.safe_load(block("yaml"))["rows"]
    assert [row["name"] for row in rows] == re.findall(r"^\| (\w+) \| \d\d\.\d\d \|", PAGE, re.MULTILINE)
    assert main(["run", *rows[1]["overrides"], "scene=tiny", "preset=smoke", "device=cpu", "threads=1", "out=result"]) == 0
    sys.modules.pop("my_prior")
