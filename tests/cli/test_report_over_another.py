"""A report that is written into the folder of a former one leaves nothing there that the former one alone had."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli.report import main
from ia_bench.report.collect import SCORES, Record
from ia_bench.report.value import FILES, write_value
from ia_bench.report.worth import gains
from ia_bench.report.write import Report, write_report
from ia_bench.runs.table import Row, Table

WAYS = Table(rows=[Row("none", []), Row("ours", [])], reference="none", captures=[{}, {"views": 8}])


def runs_of(table: Table, captures: Sequence[str]) -> list[Record]:
    found = []
    for label in captures:
        for place, row in enumerate(table.rows):
            one = {"folder": Path(), "row": row.name + label, "seed": 0, "protocol": "p", **dict.fromkeys(SCORES, 20.0 + place)}
            found += [{**one, "scene": scene} for scene in ("hat", "ship")]
    return found


def value_of(report: Report, table: Table, out: Path) -> set[str]:
    runs = report.findings.runs
    return {path.name for path in write_value(gains(runs, table), runs, table, out)}


def reported(runs: Sequence[Record], out: Path) -> Report:
    return write_report([], out, published=runs)


def test_what_a_prior_was_worth_goes_where_no_table_says_so_any_more(tmp_path: Path) -> None:
    report = reported(runs_of(WAYS, ["", ", 8 views"]), tmp_path)
    (tmp_path / "page").mkdir()
    assert value_of(report, WAYS, tmp_path) == set(FILES)
    fewer = reported(runs_of(WAYS, [""]), tmp_path)
    assert value_of(fewer, WAYS, tmp_path) == {*FILES} - {"photographs.csv"}
    assert not (tmp_path / "photographs.csv").exists()
    assert value_of(fewer, Table(), tmp_path) == set()
    assert not any((tmp_path / name).exists() for name in FILES)


def test_a_page_without_pictures_keeps_none(tmp_path: Path) -> None:
    reported(runs_of(WAYS, [""]), tmp_path / "first")
    parts = tmp_path / "out" / "page" / "parts"
    for name in ("hat/truth/drawn.json", "pictures.js", "model-viewer-umd.min.js"):
        (parts / name).parent.mkdir(parents=True, exist_ok=True)
        (parts / name).touch()
    assert main([str(tmp_path / "first" / "runs.csv"), "--out", str(tmp_path / "out")]) == 0
    assert list(parts.iterdir()) == []
