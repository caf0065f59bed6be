"""A report that is written into the folder of a former one leaves nothing there that the former one alone had."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli.report import main
from ia_bench.report.collect import SCORES, Record
from ia_bench.report.value import FILES, write_value
from ia_bench.report.write import write_report
from ia_bench.runs.table import Row, Table

WAYS = Table(rows=[Row("none", []), Row("ours", [])], reference="none", captures=[{}, {"views": 8}])


def runs_of(table: Table, captures: Sequence[str]) -> list[Record]:
    found = []
    for label in captures:
        for place, row in enumerate(table.rows):
            one = {"folder": Path(), "row": row.name + label, "seed": 0, "protocol": "p", **dict.fromkeys(SCORES, 20.0 + place)}
            found += [{**one, "scene": scene} for scene in ("hat", "ship")]
    return found


def reported(table: Table, captures: Sequence[str], out: Path) -> set[str]:
    report = write_report([], out, table, runs_of(WAYS, captures))
    return {path.name for path in write_value(report.findings, out)}


def test_what_a_prior_was_worth_goes_where_no_table_says_so_any_more(tmp_path: Path) -> None:
    assert reported(WAYS, ["", ", 8 views"], tmp_path) == set(FILES)
    assert reported(WAYS, [""], tmp_path) == {*FILES} - {"photographs.csv"}
    assert not (tmp_path / "photographs.csv").exists()
    assert reported(Table(), [""], tmp_path) == set()
    assert not any((tmp_path / name).exists() for name in FILES)


def test_a_page_without_pictures_keeps_none(tmp_path: Path) -> None:
    reported(WAYS, [""], tmp_path / "first")
    parts = tmp_path / "out" / "page" / "parts"
    for name in ("hat/truth/drawn.json", "pictures.js", "model-viewer-umd.min.js"):
        (parts / name).parent.mkdir(parents=True, exist_ok=True)
        (parts / name).touch()
    assert main([str(tmp_path / "first" / "runs.csv"), "--out", str(tmp_path / "out")]) == 0
    assert list(parts.iterdir()) == []
