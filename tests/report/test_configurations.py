"""Rows whose runs are of several configurations are named, with the settings that differ."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ia_bench.report.collect import collect
from ia_bench.report.configurations import mixed_rows
from ia_bench.report.write import write_report


def put(folder: Path, **config: Any) -> Path:
    (folder / "config.json").write_text(json.dumps({"config": config}))
    return folder


def test_a_row_whose_runs_differ_in_a_setting_is_named(write_run: Callable[..., Path], tmp_path: Path) -> None:
    steps = {0: {"stage1_steps": 12}, 1: {"stage1_steps": 60, "pixels": 9}}
    folders = [
        put(write_run(row, "hat", seed), seed=seed, scene={"name": "hat"}, method={"options": steps[seed if row == "mixed" else 0]})
        for row in ("mixed", "one")
        for seed in (0, 1)
    ]
    report = write_report(folders, tmp_path / "out")
    sentence = (
        "mixed: its runs are not of one configuration, so that its means mix them: method.options.stage1_steps (12, 60), "
        "method.options.pixels (nothing, 9)"
    )
    assert [note for note in report.findings.notes if "configuration" in note] == [sentence]
    assert f"- {sentence}\n" in (tmp_path / "out" / "report.md").read_text()


def test_seed_scene_threads_and_the_run_behind_a_score_make_no_other_configuration(write_run: Callable[..., Path]) -> None:
    folders = [
        put(write_run("ours", scene, seed), seed=seed, scene={"name": scene}, threads=1 + seed, rescored_from=f"{scene}{seed}")
        for scene in ("hat", "ship")
        for seed in (0, 1)
    ]
    folders.append(write_run("ours", "drum"))  # without any configuration
    assert mixed_rows(collect(folders).runs) == []


def test_of_many_settings_that_differ_the_first_are_named(write_run: Callable[..., Path]) -> None:
    folders = [put(write_run("ours", "hat", seed), **dict.fromkeys("abcdefgh", seed)) for seed in (0, 1)]
    (sentence,) = mixed_rows(collect(folders).runs)
    assert sentence.endswith("d (0, 1), e (0, 1) and 3 more")
