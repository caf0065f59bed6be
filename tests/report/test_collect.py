"""Reading run folders and a report's runs.csv: what is there arrives, what is broken is named and becomes a failure."""

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scored_runs import put_setup

from ia_bench.common.errors import InputError
from ia_bench.report.collect import KEPT, NOT_SCORED, as_table, collect, read_published, read_run
from ia_bench.report.curves import read_curve
from ia_bench.report.write import write_report
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.table import Claim, Table
from ia_bench.scores.metrics import MEASURED, METRICS

TRIPLES = ("albedo", "aligned_albedo", "view_synthesis", "relighting")
TABLE = Table(reference="none", claims=[Claim("ours", "none")])
RESULTS = Path(__file__).parents[2] / "docs" / "results"
Write = Callable[..., Path]


def test_a_finished_run_arrives_whole(write_run: Write) -> None:
    machine = {"commit": "abc+changes", "cpu": "Abacus 2", "threads": 1}
    more: dict[str, Any] = {"sees_truth": True, "preset": "quick", "environment": machine, "capture": {"views": 8}}
    folder = write_run("ours", "hat", 3, curve="stage1,0,0.5,,12,,,\nstage2,40,2.5,14,,inf,16,0.05\n", **more)
    put_setup(folder, config={"capture": {"views": 8, "radiometry": "ldr"}})
    (run,) = as_table([read_run(folder)]).to_dict("records")
    found = {key: run[key] for key in ("row", "scene", "seed", "problem", "protocol", "sees_truth", "seconds", "peak_memory_bytes")}
    assert [*found.values()] == ["ours", "hat", 3, None, "paper-v1 (lpips.net=alex)", True, 50.0, 2**30]  # scoring is left out
    assert (run["albedo_psnr"], run["roughness_mse"], run["seconds_stage1"]) == (20.0, 0.05, 30.0)
    made = {key: run[key] for key in ("preset", "threads", "commit", "clean", "cpu", "capture", "photographs")}
    assert [*made.values()] == ["quick", 1, "abc+changes", False, "Abacus 2", "8 views, LDR", 8]
    np.testing.assert_array_equal(run["curve"].values["albedo_psnr"], [np.nan, 14.0])
    np.testing.assert_array_equal(run["curve"].measured("relighting_psnr"), [[2.5], [16]])
    assert len(run["curve"].measured("view_synthesis_psnr")[0]) == 0  # infinite: nothing to draw
    assert not run["curve"].is_level
    assert read_run(write_run("ceiling", "hat", curve="ceiling,0,0,,,30,31,0.001\n"))["curve"].is_level
    assert read_run(write_run("short", "hat", curve=""))["curve"] is None


def test_a_score_that_is_undefined_or_unknown_says_why(write_run: Write) -> None:
    reasons = dict.fromkeys((f"{name}.psnr" for name in TRIPLES), "identical")
    run = read_run(write_run("ours", "hat", psnr=None, reasons=reasons))
    newer = {metric.key: NOT_SCORED for metric in MEASURED if metric not in METRICS}
    assert (run["albedo_psnr"], run["reasons"]) == (None, newer | reasons)
    former = read_run(write_run("former", "hat", metrics={"albedo": {"psnr": 20.0}}))
    assert (former.get("problem"), former["albedo_psnr"], former["albedo_ssim"]) == (None, 20.0, None)
    assert former["reasons"]["roughness.mse"] == NOT_SCORED


@pytest.mark.parametrize(
    ("key", "value"),
    [("schema", 1), ("status", "done"), ("metrics", None), ("metrics", {"albedo": {"psnr": "high"}}), ("protocol", None),
     ("metrics", {"albedo": {"psnr": None}}), ("time_s", {"stage1": "long"}), ("peak_memory_bytes", [1]),
     ("rays", 10**30), ("environment", "here"), ("protocol_description", "mine"), ("reasons", []),
     ("geometry", 3), ("geometry", {"depth": "far"}), ("config_hash", None), ("capture", "all"), ("row", ""), ("seed", True),
     ("scene", None), ("declared", {"seconds": "long"}), ("declared", {"hours": 1})],
)  # fmt: skip
def test_a_broken_record_is_a_failure_of_its_cell_in_a_table(write_run: Write, tmp_path: Path, key: str, value: object) -> None:
    folder = write_run("ours", "hat")
    (folder / "metrics.json").write_text(json.dumps(json.loads((folder / "metrics.json").read_text()) | {key: value}))
    (failure,) = write_report({folder: ("ours", "hat", 0)}, tmp_path / "out").findings.failures
    assert failure.startswith(f"ours, hat, seed 0: {folder / 'metrics.json'}: ")
    assert key in failure
    assert "\n" not in failure
    assert collect([folder]).unreadable == (failure.removeprefix("ours, hat, seed 0: "),)


def test_a_folder_without_a_sound_record_is_unreadable(write_run: Write, tmp_path: Path) -> None:
    folder = write_run("ours", "hat")
    (folder / "metrics.json").write_text('{"schema": 2, ')
    assert collect([folder]).unreadable[0].startswith(str(folder / "metrics.json"))
    assert str(tmp_path / "never ran") in collect([tmp_path / "never ran"]).unreadable[0]


def test_a_cell_is_what_the_table_calls_it_now_and_is_there_once(write_run: Write, tmp_path: Path) -> None:
    first = write_run("its former name", "hat", 1)
    assert collect({first: ("its name", "hat", 1)}).runs["row"].tolist() == ["its name"]
    assert collect({tmp_path / "killed": ("its name", "hat", 1)}).runs["problem"].str.contains("found none").all()
    second = tmp_path / "copy"
    second.mkdir()
    (second / "metrics.json").write_text((first / "metrics.json").read_text())
    with pytest.raises(InputError, match="seed 1 is in .* and in .*copy: expected one run per cell; .* row=NAME"):
        collect([first, second])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("stage,step\nstage1,0\n", ": expected a column seconds, found stage, step"),
        ("stage,step,seconds,albedo_psnr\nstage1,0,1,high\n", "line 2, albedo_psnr: expected a number, found 'high'"),
        ("stage,step,seconds\nstage1,0,2\nstage1,1,1\n", "expected a step and rising seconds"),
        ("stage,step,seconds\nstage1,,2\n", "expected a step and rising seconds"),
    ],
)
def test_a_broken_curve_is_named_and_does_not_fail_the_run(write_run: Write, text: str, problem: str) -> None:
    folder = write_run("ours", "hat")
    (folder / "curve.csv").write_text(text)
    with pytest.raises(InputError, match=problem):
        read_curve(folder / "curve.csv")
    run = read_run(folder)
    assert "problem" not in run
    assert re.search(problem, run["curve_problem"])


# ---- a report's runs.csv read back ------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def first(write_run_below: Write, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rows, two scenes, two seeds, of which one run failed and one has no view synthesis."""
    root = tmp_path_factory.mktemp("published")
    write_run = partial(write_run_below, root)
    for scene, psnr in (("hat", 20.0), ("ship", 24.5)):
        for seed in (0, 1):
            write_run("none", scene, seed, psnr=psnr - seed / 3)
            write_run("ours", scene, seed, psnr=psnr + 1, variants={"aligned_albedo_linear": {"psnr": 17.25}})
    write_run("ours", "hat", 2, status="failed", error="loss is not finite at step 3")
    write_run("none", "ship", 2, psnr=None)
    write_report(find_run_folders(root / "runs"), root / "first", TABLE)
    return root / "first" / "runs.csv"


def test_tables_of_a_runs_csv_are_those_of_its_runs(first: Path, tmp_path: Path) -> None:
    write_report([], tmp_path / "again", TABLE, read_published(first))
    for name in ("table.csv", "runs.csv", "differences.csv", "claims.csv"):
        again, before = (pd.read_csv(folder / name) for folder in (tmp_path / "again", first.parent))
        assert len(before) > 0
        pd.testing.assert_frame_equal(again, before, check_like=True, check_dtype=False, rtol=1e-12)


def test_new_rows_stand_beside_published_ones_unless_a_cell_is_there_twice(first: Path, write_run: Write, tmp_path: Path) -> None:
    mine = write_run("mine", "hat", psnr=30.0)
    report = write_report([mine], tmp_path / "both", TABLE, read_published(first))
    assert set(report.findings.rows) == {"none", "ours", "mine"}
    assert len(report.findings.runs) == 11
    with pytest.raises(InputError, match=r"row none, scene hat, seed 0 is in .* and in .*runs\.csv.* another name with row=NAME"):
        write_report([write_run("none", "hat", config_hash="another")], tmp_path / "out", published=read_published(first))


def test_the_folder_of_a_published_run_adds_its_curve(first: Path, write_run: Write) -> None:
    folder = write_run("none", "hat", curve="stage1,0,0.5,,12,,,\nstage2,40,2.5,14,,15,16,0.05\n")
    lines = read_published(first)
    runs = collect([folder], lines).runs
    assert len(runs) == len(lines)
    (run,) = runs[(runs["row"] == "none") & (runs["scene"] == "hat") & (runs["seed"] == 0)].to_dict("records")
    assert (run["albedo_psnr"], run["folder"], run["problem"]) == (20.0, folder, None)
    np.testing.assert_array_equal(run["curve"].values["albedo_psnr"], [np.nan, 14.0])
    with pytest.raises(InputError, match=r"row none, scene hat, seed 0 is in .*hat-0 and in .*runs\.csv"):
        collect([folder], [*lines, lines[0]])


@pytest.mark.parametrize(
    ("row", "again"),
    [("none", {"psnr": 20.1}), ("none", {"status": "failed", "error": "the disk is full"}), ("ours", {"seed": 2})],
    ids=["other scores", "failed here", "failed there"],
)
def test_a_run_that_ended_otherwise_is_not_the_one_that_was_published(first: Path, write_run: Write, row: str, again: Any) -> None:
    """Though it has the same identity, as one on another machine: its own numbers must not go without a word."""
    with pytest.raises(InputError, match=rf"row {row}, scene hat, seed . is in .*hat-. and in .*runs\.csv"):
        collect([write_run(row, "hat", **again)], read_published(first))


@pytest.mark.parametrize("path", sorted(RESULTS.rglob("runs.csv")), ids=lambda path: path.parent.name)
def test_every_list_of_runs_that_was_ever_published_is_read(path: Path) -> None:
    runs, lines = as_table(read_published(path)), pd.read_csv(path)
    assert len(runs) == len(lines) > 0
    for metric in METRICS:
        if metric.column in lines:
            np.testing.assert_array_equal(runs[metric.column], lines[metric.column])


def test_a_list_without_a_metric_or_with_another_column_is_read(first: Path, tmp_path: Path) -> None:
    lines = pd.read_csv(first).drop(columns=["roughness_mse", "seconds", "protocol"]).assign(sharpness=3.5, remark="fine")
    lines.to_csv(tmp_path / "runs.csv", index=False)
    runs = as_table(read_published(tmp_path / "runs.csv"))
    assert (runs["roughness_mse"].isna() & runs["seconds"].isna()).all()
    assert set(runs.loc[runs["problem"].isna(), "protocol"]) == {"unknown"}
    assert (runs["sharpness"] == 3.5).all()
    assert runs.loc[0, "reasons"]["roughness.mse"] == NOT_SCORED


def test_lines_longer_than_the_names_of_columns_are_refused_and_unknown_columns_passed_over(tmp_path: Path, first: Path) -> None:
    """The row would be none, or what is in the second column."""
    (tmp_path / "runs.csv").write_text("row,scene,seed,albedo_psnr\nnone,7,0,20.0,\nnone,7,1,21.0,\n")
    with pytest.raises(InputError, match=r"runs\.csv: expected a report's runs\.csv, found: Length of header"):
        read_published(tmp_path / "runs.csv")
    lines = pd.read_csv(first, dtype=str, keep_default_na=False).assign(**dict.fromkeys(KEPT, 1))
    lines.to_csv(tmp_path / "runs.csv", index=False)
    assert read_published(tmp_path / "runs.csv") == [{**run, "folder": tmp_path / "runs.csv"} for run in read_published(first)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",seed,", ",sed,", "found no column seed"),
        ("none,hat,0,", "none,hat,zero,", "line 2, seed: expected a whole number below 2.63, found 'zero'"),
        ("none,hat,0,", "none,hat,0.5,", "line 2, seed: expected a whole number"),
        ("none,hat,0,", "no\0ne,hat,0,", "line 2: expected a row, a scene and a seed"),
        ("none,hat,0,", ",hat,0,", "line 2: expected a row, a scene and a seed"),
        ("none,hat,0,ok,,False", "none,hat,0,ok,,0", "line 2, sees_truth: expected true or false, found '0'"),
        ("none,hat,0,ok,", "none,hat,0,OK,", "line 2, status: expected ok or failed, found 'OK'"),
        (",20.0,", ",twenty,", "albedo_psnr: expected a number, found 'twenty'"),
    ],
)
def test_what_is_wrong_is_named(first: Path, tmp_path: Path, old: str, new: str, message: str) -> None:
    text, wrong = first.read_text(), tmp_path / "runs.csv"
    assert old in text
    wrong.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_published(wrong)


def test_reasons_with_signs_of_their_own_and_shapes_come_back(write_run: Write, tmp_path: Path) -> None:
    why = "dusk: identical (image 1); noon: no scored pixel (every image)"
    shape = {"missed_share": 0.25, "normals_degrees": None, "reasons": {"normals_degrees": "the scene has no true mesh"}}
    run = write_run("none", "hat", psnr=None, reasons={f"{name}.psnr": why for name in TRIPLES}, geometry=shape)
    write_report([run, write_run("given", "hat")], tmp_path / "out")
    given, after = read_published(tmp_path / "out" / "runs.csv")
    assert after["reasons"] == read_run(run)["reasons"]
    assert after["geometry_missed_share"] == 0.25
    assert "geometry_missed_share" not in given


def test_what_prepares_the_scene_counts_for_no_row(write_run: Write) -> None:
    """A hull is made by whichever row comes first and kept for the others: rows that took as long must say so."""
    spent = {"total": 160.0, "bake": 5.0, "prior": 1.0, "stage1": 30.0, "score": 10.0, "pictures": 4.0}
    first = read_run(write_run("first", "hat", time_s=spent | {"capture": 110.0}))
    second = read_run(write_run("second", "hat", time_s=spent | {"capture": 0.01}))
    assert first["seconds"] == second["seconds"] == 36.0
    assert first["seconds_capture"] == 110.0, "it is still told"


def test_what_a_record_of_others_says_in_several_lines_ends_no_list_and_no_caption(write_run: Write, tmp_path: Path) -> None:
    """Markdown would take the third line for a heading of the report, and LaTeX stop at the empty one."""
    said = "not finite\n\n# Results of another"
    failed = write_run("theirs", "hat", status="failed", error=said)
    undefined = write_run("ours", "hat", psnr=None, reasons={f"{name}.psnr": said for name in TRIPLES})
    out = write_report([failed, undefined], tmp_path / "out").files[0].parent
    assert "# Results of another" not in (out / "report.md").read_text().splitlines()
    assert "- theirs, hat, seed 0: not finite # Results of another" in (out / "report.md").read_text().splitlines()
    assert r"not finite \# Results of another" in (out / "table.tex").read_text()
