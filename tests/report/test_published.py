"""A report's runs.csv read back: the same tables come of it, new rows stand beside it, and what is wrong in it is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from ia_bench.common.errors import InputError
from ia_bench.report.collect import collect
from ia_bench.report.published import read_published
from ia_bench.report.write import write_report
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.table import Claim

Write = Callable[..., Path]
CLAIMS = [Claim("ours", "none", ["albedo.psnr"])]


@pytest.fixture
def first(write_run: Write, tmp_path: Path) -> Path:
    """Two rows, two scenes, two seeds, of which one run failed and one has no view synthesis."""
    for scene, psnr in (("hat", 20.0), ("ship", 24.5)):
        for seed in (0, 1):
            write_run("none", scene, seed, psnr=psnr - seed / 3)
            write_run("ours", scene, seed, psnr=psnr + 1, variants={"aligned_albedo_linear": {"psnr": 17.25}})
    write_run("ours", "hat", 2, status="failed", error="loss is not finite at step 3")
    write_run("none", "ship", 2, psnr=None)
    write_report(find_run_folders(tmp_path / "runs"), tmp_path / "first", reference="none", claims=CLAIMS)
    return tmp_path / "first" / "runs.csv"


@pytest.mark.parametrize("name", ["table.csv", "runs.csv", "differences.csv", "claims.csv"])
def test_tables_of_a_runs_csv_are_those_of_its_runs(first: Path, tmp_path: Path, name: str) -> None:
    write_report([], tmp_path / "again", reference="none", claims=CLAIMS, published=read_published(first))
    again, before = (pd.read_csv(folder / name) for folder in (tmp_path / "again", first.parent))
    assert len(before) > 0
    pd.testing.assert_frame_equal(again, before, check_like=True, check_dtype=False, rtol=1e-12)


def test_without_curves_nothing_is_said_about_time(first: Path, tmp_path: Path) -> None:
    write_report([], tmp_path / "again", reference="none", published=read_published(first))
    assert "Where more time makes it worse" not in (tmp_path / "again" / "report.md").read_text()


def test_new_rows_stand_beside_published_ones(first: Path, write_run: Write, tmp_path: Path) -> None:
    mine = write_run("mine", "hat", psnr=30.0)
    report = write_report([mine], tmp_path / "both", reference="none", published=read_published(first))
    assert set(report.findings.rows) == {"none", "ours", "mine"}
    assert len(report.findings.runs) == 11


def test_a_cell_that_is_there_twice_is_refused(first: Path, write_run: Write, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    with pytest.raises(ValueError, match=r"row none, scene hat, seed 0 is in .* and in .*runs\.csv"):
        write_report([tmp_path / "runs" / "none-hat-0"], tmp_path / "out", published=read_published(first))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",seed,", ",sed,", "found no column seed"),
        ("none,hat,0,", "none,hat,zero,", "line 2, seed: expected a number, found 'zero'"),
        ("none,hat,0,", "none,hat,0.5,", "line 2: expected a row, a scene and a whole seed"),
        ("none,hat,0,ok,,False", "none,hat,0,ok,,0", "line 2, sees_truth: expected true or false, found '0'"),
        ("none,hat,0,ok,", "none,hat,0,OK,", "line 2, status: expected ok or failed, found 'OK'"),
        (",20.0,", ",twenty,", "albedo_psnr: expected a number, found 'twenty'"),
    ],
)
def test_what_is_wrong_is_named(first: Path, old: str, new: str, message: str) -> None:
    text = first.read_text()
    assert old in text
    first.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_published(first)


@pytest.mark.parametrize("text", ["True", "TRUE", "true"])
def test_a_row_sees_the_truth_in_whatever_case_a_spreadsheet_has_written_so(first: Path, text: str) -> None:
    first.write_text(first.read_text().replace("none,hat,0,ok,,False", f"none,hat,0,ok,,{text}", 1))
    assert [run.name for run in read_published(first) if run.sees_truth] == ["none, hat, seed 0"]


def test_the_shape_that_a_capture_made_has_columns(write_run: Write, tmp_path: Path) -> None:
    shape = {"missed_share": 0.01, "normals_degrees": None, "reasons": {"normals_degrees": "the scene has no true mesh"}}
    runs = [write_run("hull", "hat", geometry=shape), write_run("given", "hat", geometry={})]
    write_report(runs, tmp_path / "out", reference="given")
    columns = pd.read_csv(tmp_path / "out" / "runs.csv").set_index("row")["geometry_missed_share"]
    assert columns["hull"] == 0.01
    assert pd.isna(columns["given"])


def test_reasons_with_signs_of_their_own_and_names_with_underscores_come_back(write_run: Write, tmp_path: Path) -> None:
    names = ("albedo", "aligned_albedo", "view_synthesis", "relighting")
    why = "dusk: identical (image 1); noon: no scored pixel (every image)"
    shape = {"missed_share": 0.25, "chamfer": 0.5}
    run = write_run("none", "hat", psnr=None, reasons={f"{name}.psnr": why for name in names}, geometry=shape)
    write_report([run], tmp_path / "out")
    before = collect([run]).runs[0]
    (after,) = read_published(tmp_path / "out" / "runs.csv")
    assert before.reasons["albedo.psnr"] == why
    assert {key: after.reason(key) for key, value in after.metrics.items() if value is None} == {
        key: before.reason(key) for key, value in before.metrics.items() if value is None
    }
    assert after.variants == before.variants
    assert after.variants["geometry.missed_share"] == 0.25
