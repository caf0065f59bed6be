"""A report is a command of its own: of run folders alone, the same as after a table, and nothing of a former one is left."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from report.scored_runs import scored
from run_records import write_record

import ia_bench as ib
from ia_bench.cli.report import main
from ia_bench.cli.rescore import main as rescore
from ia_bench.report.value import FILES, write_value
from ia_bench.report.write import write_report
from ia_bench.runs.table import Row, Table


def test_runs_of_several_folders_are_reported_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_record(tmp_path / "mine" / "a", "none", 20.0)
    write_record(tmp_path / "yours" / "b", "ours", 22.0)
    arguments = [*map(str, (tmp_path / "mine", tmp_path / "yours")), "--out", str(tmp_path / "out"), "--reference", "none"]
    (tmp_path / "yours" / "torn").mkdir()
    (tmp_path / "yours" / "torn" / "metrics.json").touch()
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "left out, no record of a run: " in printed.partition("\n| Row ")[0], "before any number"
    assert "Protocol paper-v1 (lpips.net=alex), mean over scenes" in printed
    assert "| ours | 22.00 |" in printed
    assert "+2.00" in (tmp_path / "out" / "report.md").read_text()


def test_without_a_folder_it_lies_beside_the_runs_and_a_browser_opens_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_record(Path("runs", "a"), "none", 20.0)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or len(opened) == 1)
    assert main(["runs/a", "--open"]) == main(["runs/a", "--open"]) == 0
    page = tmp_path / "runs" / "a-report" / "page" / "index.html"
    assert opened == [page.as_uri()] * 2
    assert page.is_file()
    assert capsys.readouterr().out.endswith("no browser was found here; open runs/a-report/page/index.html in one\n")


def test_a_root_has_no_name_for_a_folder_beside_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("ia_bench.cli.report.folders_with_cells", lambda *_: {})
    assert main(["/"]) == 2
    assert "--out: expected a folder" in capsys.readouterr().err


def test_a_reference_is_found_by_the_name_that_its_captures_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs on one's own photographs are called after their capture: none, hull."""
    write_record(tmp_path / "runs" / "a", "none, hull", 20.0)
    write_record(tmp_path / "runs" / "b", "ours, hull", 22.0)
    arguments = [str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--reference", "none"]
    assert main(arguments) == 0
    assert "+2.00" in (tmp_path / "out" / "report.md").read_text()
    write_record(tmp_path / "runs" / "c", "none, sdf", 23.0)
    assert main(arguments) == 2
    assert "expected one of the rows 'none, hull', 'none, sdf', 'ours, hull', found none" in capsys.readouterr().err


def test_a_file_beside_the_runs_that_a_shell_has_named_is_passed_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_record(tmp_path / "runs" / "a", "none", 20.0)
    (tmp_path / "runs" / "contact_sheet.png").touch()
    named = [str(path) for path in (tmp_path / "runs").iterdir()]
    assert main([*named, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert "contact_sheet.png: passed over, since it is a file" in told.err
    assert "| none |" in told.out
    assert main([str(tmp_path / "runs" / "contact_sheet.png"), "--out", str(tmp_path / "out")]) == 2
    assert "contact_sheet.png: expected a folder with runs, found none" in capsys.readouterr().err
    assert main([*named, str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 2
    assert "nowhere: expected a folder with runs, found none" in capsys.readouterr().err


def list_cells(results: Path, table: str, *cells: tuple[str, str, str]) -> None:
    """The cells.json of a table with this row, scene and folder of each cell."""
    same = {"seed": 0, "config_hash": "0" * 8, "log": "log"}
    listed = [{**same, "row": row, "scene": scene, "folder": f"runs/{folder}"} for row, scene, folder in cells]
    (results / "cells.json").write_text(json.dumps({"table": table, "jobs": 1, "cells": listed}))


def test_of_a_tables_results_the_cells_of_its_last_call_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A former call of the same table had other settings: the same cell twice, which nothing but cells.json tells apart."""
    for folder, psnr in (("hat", 20.0), ("former", 30.0)):
        write_record(tmp_path / "results" / "runs" / folder, "none", psnr)
    list_cells(tmp_path / "results", "paper", ("mine", "hat", "hat"), ("mine", "not_begun", "not_begun"))
    assert main([str(tmp_path / "results"), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert "results: 1 run is left out, since cells.json there, of the table's last call, does not list more" in told.err
    (line,) = csv.DictReader((tmp_path / "out" / "runs.csv").open())
    assert (line["row"], line["scene"], line["albedo_psnr"], line["status"]) == ("mine", "hat", "20.0", "ok")
    assert ib.table([tmp_path / "results"])[["row", "albedo_psnr"]].to_numpy().tolist() == [["mine", 20.0]]
    assert rescore([str(tmp_path / "results"), "--out", str(tmp_path / "again")]) == 1  # records alone cannot be scored
    told = capsys.readouterr()
    assert f"{tmp_path / 'results' / 'runs' / 'hat'}" in told.err
    assert f"{tmp_path / 'results' / 'runs' / 'former'}" not in told.err
    assert main([str(tmp_path / "results" / "runs"), "--out", str(tmp_path / "out")]) == 2
    assert "expected one run per cell" in capsys.readouterr().err


SEVERAL_WAYS = """
scenes: [hat, ship]
reference: none
captures: [{}, {views: 8}]
rows: [{name: none, overrides: []}, {name: longer, overrides: []}, {name: ours, overrides: []}]
"""


def test_results_of_a_table_are_reported_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of two of its three rows; once its file is gone, as any runs."""
    table, results = tmp_path / "ways.yaml", tmp_path / "results"
    table.write_text(SEVERAL_WAYS.replace("{name: longer,", "{name: 'longer,too', note: more steps,"))
    for row, psnr in {"none": 20.0, "longer,too": 23.0}.items():
        write_record(results / "runs" / row, row, psnr)
    list_cells(results, str(table), ("none", "hat", "none"), ("longer,too", "hat", "longer,too"))
    assert main([str(results), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert f"reported as table {table}" in said.err
    assert "longer,too: more steps" in said.out
    assert "ours" not in said.out
    assert "| longer,too | 23.00 |" in said.out, "the mean over the scene that was asked for, not over one of two"
    assert "minus the row without a prior of the same scene" in (tmp_path / "out" / "page" / "index.html").read_text()
    table.unlink()
    assert main([str(results), "--out", str(tmp_path / "out")]) == 0
    assert "more steps" not in capsys.readouterr().out


@pytest.mark.parametrize("reference", ["longer", "longer, 8 views"])
def test_another_reference_is_that_of_every_part_of_the_report(tmp_path: Path, reference: str) -> None:
    """Ours is 5 dB above none and 2 above longer, with each capture."""
    (tmp_path / "ways.yaml").write_text(SEVERAL_WAYS)
    for row, psnr in {"none": 20.0, "longer": 23.0, "ours": 25.0}.items():
        for label in ("", ", 8 views"):
            write_record(tmp_path / "runs" / f"{row}{label}", f"{row}{label}", psnr)
    table = str(tmp_path / "ways.yaml")
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--table", table, "--reference", reference]) == 0
    gained = list(csv.DictReader((tmp_path / "out" / "value.csv").open()))
    assert {line["row"]: float(line["gain"]) for line in gained if line["metric"] == "albedo.psnr"} == {"none": -3.0, "ours": 2.0}
    assert "Every row against `longer` of the same scene" in (tmp_path / "out" / "value.md").read_text()
    assert "dB gained over longer; hatched" in (tmp_path / "out" / "value.svg").read_text()
    page = (tmp_path / "out" / "page" / "index.html").read_text()
    assert "A row minus the row longer of the same scene" in page
    assert "ours, 8 views: +2.00 dB over longer, 8 views" in page


def test_another_reference_has_no_rows_with_more_work(tmp_path: Path) -> None:
    """Those that the table names for it are more work of its own reference."""
    rows = ", ".join(f"{{name: {row}, overrides: []}}" for row in ("none", "longer", "ours"))
    (tmp_path / "curved.yaml").write_text(f"scenes: [hat]\nreference: none\ncurve: [longer]\nrows: [{rows}]\n")
    for row in ("none", "longer", "ours"):
        write_record(tmp_path / "runs" / row, row, 20.0)
    for reference, told in {"none": "the best of “none” (1.00), “longer” (1.00)", "ours": "“ours” was not run"}.items():
        given = ["--out", str(tmp_path / "out"), "--table", str(tmp_path / "curved.yaml"), "--reference", reference]
        assert main([str(tmp_path / "runs"), *given]) == 0
        assert told in (tmp_path / "out" / "report.md").read_text()


WAYS = Table(rows=[Row("none", []), Row("ours", [])], reference="none", captures=[{}, {"views": 8}])


def reported(table: Table, captures: Sequence[str], out: Path) -> set[str]:
    runs = [
        scored(row.name + label, scene, 0, 20.0 + place)
        for label in captures
        for place, row in enumerate(WAYS.rows)
        for scene in ("hat", "ship")
    ]
    return {path.name for path in write_value(write_report([], out, table, runs).findings, out)}


def test_what_a_prior_was_worth_goes_where_no_table_says_so_any_more(tmp_path: Path) -> None:
    assert reported(WAYS, ["", ", 8 views"], tmp_path) == set(FILES)
    assert reported(WAYS, [""], tmp_path) == {*FILES} - {"photographs.csv"}
    assert not (tmp_path / "photographs.csv").exists()
    assert reported(Table(), [""], tmp_path) == set()
    assert not any((tmp_path / name).exists() for name in FILES)


def test_published_runs_of_which_none_is_of_the_table_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are there: what is missing are rows, not runs."""
    monkeypatch.chdir(tmp_path)
    Path("runs.csv").write_text("row,scene,seed,albedo_psnr\nnone,hat,0,20\nours,hat,0,21\n")
    Path("t.yaml").write_text("rows: [{name: nome, overrides: []}]")
    assert main(["runs.csv", "--table", "t.yaml", "--only", "--out", "out"]) == 2
    assert "--only: expected runs of a row of table t.yaml (nome), found none, ours" in capsys.readouterr().err
