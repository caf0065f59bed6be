"""What a release says of itself is the same in every place that says it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = [tomllib.loads((ROOT / part / "pyproject.toml").read_text())["project"] for part in (".", "baselines", "training")]


def test_versions_and_licences_agree() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {(each["version"], each["license"]) for each in DISTRIBUTIONS} == {(citation["version"], citation["license"])}
    pinned = [line for each in DISTRIBUTIONS for extra in each.get("optional-dependencies", {}).values() for line in extra]
    ours = [line for line in pinned if line.startswith("ia_bench_")]
    assert ours
    assert {line.partition("==")[2] for line in ours} == {citation["version"]}


def test_the_changelog_has_the_version() -> None:
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest is not None
    assert newest[1].rstrip(",") == DISTRIBUTIONS[0]["version"]


def test_the_citation_has_what_its_format_asks_for() -> None:
    """The keys that the schema of CFF 1.2.0 requires, of the file and of each reference."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= citation.keys()
    assert all({"type", "title", "authors"} <= reference.keys() for reference in citation["references"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", str(citation["date-released"]))
