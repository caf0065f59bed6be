"""What a release says of itself is the same in every place that says it."""

import json
import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
DISTRIBUTIONS = [tomllib.loads((ROOT / part / "pyproject.toml").read_text())["project"] for part in (".", "baselines", "training")]
ROOT_KEYS = {"abstract", "authors", "cff-version", "date-released", "doi", "keywords", "license", "message", "references"}
ROOT_KEYS |= {"repository-code", "title", "type", "url", "version"}
REFERENCE_KEYS = {"authors", "collection-title", "doi", "journal", "title", "type", "url", "version", "volume", "year"}
"""Those of the schema that a paper or a program needs; it has more."""


def test_versions_licences_and_the_day_in_the_changelog_agree() -> None:
    assert {(each["version"], each["license"]) for each in DISTRIBUTIONS} == {(CITATION["version"], CITATION["license"])}
    pinned = [line for each in DISTRIBUTIONS for extra in each.get("optional-dependencies", {}).values() for line in extra]
    ours = [line for line in pinned if line.startswith("ia_bench_")]
    assert ours
    assert {line.partition("==")[2] for line in ours} == {CITATION["version"]}
    newest = re.search(r"^## (\S+), (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest.groups() == (CITATION["version"], str(CITATION["date-released"]))


def test_the_citation_keeps_to_its_format() -> None:
    """The keys that the schema of CFF 1.2.0 requires and allows, and the types of those that are there; it allows no others."""
    assert CITATION["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= CITATION.keys() <= ROOT_KEYS
    assert CITATION["type"] in ("software", "dataset")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", str(CITATION["date-released"]))
    assert all({"type", "title", "authors"} <= reference.keys() <= REFERENCE_KEYS for reference in CITATION["references"])
    assert {reference["type"] for reference in CITATION["references"]} <= {"conference-paper", "article", "software"}
    for work in (CITATION, *CITATION["references"]):
        assert work["authors"]
        assert all(author.keys() in ({"name"}, {"family-names", "given-names"}) for author in work["authors"])
        texts = {key: value for key, value in work.items() if key not in ("authors", "references", "date-released", "year")}
        assert all(isinstance(value, str) and value for value in texts.values())
        assert work.get("url", "https://").startswith("https://")
        assert isinstance(work.get("year", 0), int)


def test_title_authors_and_licence_are_everywhere_the_same() -> None:
    described = json.loads((ROOT / "datasets" / "croissant.json").read_text(encoding="utf-8"))
    licence = (ROOT / "datasets" / "LICENSE").read_text(encoding="utf-8")
    assert (ROOT / "README.md").read_text(encoding="utf-8").startswith(f"# {CITATION['title']}\n")
    assert (described["version"], described["license"] in licence) == (CITATION["version"], True)
    names = [author["name"] for author in CITATION["authors"]]
    told = [each["authors"] for each in DISTRIBUTIONS] + [described["creator"]]
    assert all([author["name"] for author in authors] == names for authors in told)
    assert all(name in licence for name in names)
