"""Reading run folders: what is there arrives, what is broken is named and becomes a failure."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ia_bench.report.collect import BadRecord, collect, read_curve, read_run
from ia_bench.runs.folder import find_run_folders
from ia_bench.scores.columns import METRICS

TRIPLES = ("albedo", "aligned_albedo", "view_synthesis", "relighting")

Write = Callable[..., Path]


def test_a_finished_run_arrives_whole(write_run: Write) -> None:
    folder = write_run("ours", "hat", 3, sees_truth=True, curve="stage1,0,0.5,,12,,,\nstage2,40,2.5,14,,inf,16,0.05\n")
    run = read_run(folder)
    assert (run.row, run.scene, run.seed, run.problem, run.protocol) == ("ours", "hat", 3, None, "paper-v1 (lpips.net=alex)")
    assert run.metrics["albedo.psnr"] == 20.0
    assert run.metrics["roughness.mse"] == 0.05
    assert set(run.metrics) == {metric.key for metric in METRICS}
    assert run.seconds == 50.0  # of baking, stage 1 and stage 2; 10 of scoring are left out
    assert run.peak_memory_bytes == 2**30
    assert run.sees_truth
    assert run.curve.phases == ("stage1", "stage2")
    np.testing.assert_array_equal(run.curve.values["albedo_psnr"], [np.nan, 14.0])
    np.testing.assert_array_equal(run.curve.measured("relighting_psnr"), [[40], [2.5], [16]])
    assert len(run.curve.measured("view_synthesis_psnr")[0]) == 0  # infinite: nothing to draw
    assert not run.curve.is_level


def test_what_prepares_the_scene_counts_for_no_row(write_run: Write) -> None:
    """A hull is made by whichever row comes first and kept for the others: rows that took as long must say so."""
    spent = {"total": 160.0, "bake": 5.0, "prior": 1.0, "stage1": 30.0, "score": 10.0, "pictures": 4.0}
    first = read_run(write_run("first", "hat", time_s=spent | {"capture": 110.0}))
    second = read_run(write_run("second", "hat", time_s=spent | {"capture": 0.01}))
    assert first.seconds == second.seconds == 36.0
    assert first.phases["capture"] == 110.0, "it is still told"


def test_null_and_its_reason_arrive(write_run: Write) -> None:
    reasons = dict.fromkeys((f"{name}.psnr" for name in TRIPLES), "identical")
    run = read_run(write_run("ours", "hat", psnr=None, reasons=reasons))
    assert run.metrics["albedo.psnr"] is None
    assert run.reasons == reasons
    assert run.reason("albedo.psnr") == "identical"


def test_a_run_that_knows_neither_its_shape_nor_its_machine_arrives(write_run: Write) -> None:
    unknown = {"geometry": "no mesh was made", "environment": "not recorded"}
    run = read_run(write_run("ours", "hat", reasons=unknown, **dict.fromkeys(unknown)))
    assert run.problem is None
    assert run.about["commit"] is None


def test_a_failed_run_says_why(write_run: Write) -> None:
    assert read_run(write_run("ours", "hat", status="failed", metrics={}, error="out of memory")).problem == "out of memory"
    assert "metrics.json: error: missing" in (read_run(write_run("ours", "ship", status="failed")).problem or "")


def test_a_run_without_a_curve(write_run: Write) -> None:
    run = read_run(write_run("ours", "hat"))
    assert run.curve is None
    assert run.curve_problem is None


def test_the_ceiling_is_known_by_its_only_stage(write_run: Write) -> None:
    assert read_run(write_run("ceiling", "hat", curve="ceiling,0,0,,,30,31,0.001\n")).curve.is_level


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"schema": 1}, r"metrics\.json: schema: expected 2, found 1"),
        ({"status": "done"}, r"metrics\.json: status: expected 'ok' or 'failed', found 'done'"),
        ({"metrics": None}, r"metrics\.json: metrics: expected dict, found None"),
        ({"metrics": {}}, r"metrics\.json: metrics\.albedo: missing"),
        ({"time_s": {"stage1": "long"}}, r"metrics\.json: time_s\.stage1: expected a number, found 'long'"),
        ({"peak_memory_bytes": True}, r"metrics\.json: peak_memory_bytes: expected int, found True"),
        ({"protocol": None}, r"metrics\.json: protocol: expected str, found None"),
        ({"sees_truth": 1}, r"metrics\.json: sees_truth: expected bool, found 1"),
        ({"metrics": {"albedo": {"psnr": "high"}}}, r"metrics\.json: metrics\.albedo\.psnr: expected a number, found 'high'"),
        ({"metrics": {"albedo": {"psnr": None}}}, r"metrics\.json: metrics\.albedo\.psnr: is null without a reason"),
        ({"variants": {"albedo_linear": [1]}}, r"metrics\.json: variants\.albedo_linear: expected dict, found \[1\]"),
        ({"environment": "here"}, r"metrics\.json: environment: expected dict, found 'here'"),
        ({"protocol_description": "mine"}, r"metrics\.json: protocol_description: expected dict, found 'mine'"),
        ({"peak_memory_bytes": 1.5}, r"metrics\.json: peak_memory_bytes: expected int, found 1.5"),
        ({"reasons": []}, r"metrics\.json: reasons: expected dict, found \[\]"),
    ],
)
def test_a_broken_record_makes_its_cell_a_failed_one(write_run: Write, changes: dict, problem: str) -> None:
    run = read_run(write_run("ours", "hat", **changes))
    assert (run.row, run.scene, run.seed) == ("ours", "hat", 0)
    assert re.search(problem, run.problem or "finished")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"schema": 2, ', "not valid JSON"),
        ("[]", "expected a JSON object, found list"),
        ('{"row": "a", "scene": "b"}', "seed: expected int, found nothing"),
        ('{"row": "a", "scene": "b", "seed": true}', "seed: expected int, found True"),
        ("[" * 100_000, "not valid JSON"),
    ],
)
def test_a_record_that_names_no_cell_is_unreadable(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "metrics.json").write_text(text)
    with pytest.raises(BadRecord, match=problem):
        read_run(tmp_path)


def test_folders_are_found_and_grouped_and_the_unreadable_ones_kept(write_run: Write, tmp_path: Path) -> None:
    for seed in (0, 1):
        write_run("ours", "hat", seed)
    (tmp_path / "runs" / "broken").mkdir()
    (tmp_path / "runs" / "broken" / "metrics.json").write_text("{")
    found = collect(find_run_folders(tmp_path))
    assert [(run.row, run.scene, run.seed) for run in found.runs] == [("ours", "hat", 0), ("ours", "hat", 1)]
    assert [str(tmp_path / "runs" / "broken" / "metrics.json") in why for why in found.unreadable] == [True]
    assert str(tmp_path / "never ran") in collect([tmp_path / "never ran"]).unreadable[0]


def test_a_cell_is_what_the_table_calls_it_now(write_run: Write) -> None:
    folder = write_run("its former name", "hat", 1)
    (run,) = collect({folder: ("its name", "hat", 1)}).runs
    assert (run.row, run.scene, run.seed, run.problem) == ("its name", "hat", 1, None)


def test_two_folders_of_one_cell_are_refused(write_run: Write, tmp_path: Path) -> None:
    first = write_run("ours", "hat")
    second = tmp_path / "copy"
    second.mkdir()
    (second / "metrics.json").write_text((first / "metrics.json").read_text())
    with pytest.raises(ValueError, match="row ours, scene hat, seed 0 is in .* and in .*copy: expected one run"):
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
def test_a_broken_curve_is_named_and_does_not_fail_the_run(write_run: Write, tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(BadRecord, match=problem):
        read_curve(path)
    folder = write_run("ours", "hat")
    path.rename(folder / "curve.csv")
    run = read_run(folder)
    assert run.problem is None
    assert run.curve is None
    assert "curve.csv" in run.curve_problem


def test_a_curve_with_a_header_only_is_no_curve(write_run: Write) -> None:
    assert read_run(write_run("ours", "hat", curve="")).curve is None


def test_the_columns_are_those_of_metrics_json_and_point_the_right_way() -> None:
    assert [metric.key for metric in METRICS if not metric.higher_is_better] == [
        "albedo.lpips",
        "aligned_albedo.lpips",
        "view_synthesis.lpips",
        "relighting.lpips",
        "roughness.mse",
    ]
    assert json.dumps([metric.title for metric in METRICS[:3]], ensure_ascii=False) == (
        '["Albedo PSNR ↑", "Albedo SSIM ↑", "Albedo LPIPS ↓"]'
    )
