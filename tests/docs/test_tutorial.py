"""What the tutorial, the page of usage and the notation show: a prior that passes the check as it says, tables, names."""

import re
import sys
from pathlib import Path
from textwrap import dedent

import pytest
import yaml
from test_walks import stated

from ia_bench.cli.main import main
from ia_bench.runs.table import load_table

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def test_its_prior_is_checked_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # to which the command adds the folder where one is
    assert stated("a prior") == {"my_prior.py"}
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


def test_the_table_of_the_usage_page_is_one(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "usage.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^    scenes:.*?(?=^\S)", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "mine.yaml").write_text(dedent(shown), encoding="utf-8")
    table = load_table(str(tmp_path / "mine.yaml"))
    assert table.scene_names == ["hat", "mug"]
    assert table.claims


def test_names_of_the_notation_are_in_the_files_beside_them() -> None:
    page = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8")
    missing = []
    for _, code, where in re.findall(r"^\| (.+) \| (.*`.*) \| (`.+) \|$", page, re.MULTILINE):
        places = [ROOT / "ia_bench" / place for place in re.findall(r"`([^`]+)`", where)]
        files = [file for place in places for file in ([place] if place.is_file() else place.rglob("*.py"))]
        words = {word for file in files for word in re.findall(r"\w+", file.read_text(encoding="utf-8"))}
        missing += [
            name for name in re.findall(r"`([^`]+)`", code) if re.findall(r"[a-z_]\w*", name, re.IGNORECASE)[-1] not in words
        ]
    assert not missing, ", ".join(missing)
