"""Runs that were made in different ways are told apart, and rows whose runs are of several configurations are named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scored_runs import put_setup, scored

from ia_bench.report.collect import as_table, collect
from ia_bench.report.origins import mixed_rows, origins, seconds_compare, warnings
from ia_bench.report.write import write_report

Write = Callable[..., Path]


def test_presets_threads_commits_and_changed_code_that_mix_stand_first(write_run: Write, tmp_path: Path) -> None:
    made = [("quick", 1, "abc"), ("quick", 1, "abc"), ("smoke", 2, "def+changes")]
    for seed, (preset, threads, commit) in enumerate(made):
        machine = {"commit": commit, "cpu": "Abacus 2", "threads": threads}
        write_run("ours" if seed < 2 else "fast", "hat", seed, preset=preset, environment=machine)
    found = write_report(sorted((tmp_path / "runs").iterdir()), tmp_path / "out").findings
    assert found.warnings == (
        "Runs of different presets stand side by side: quick (2), smoke (1).",
        "Runs of different numbers of threads stand side by side: 1 (2), 2 (1).",
        "Runs of different commits stand side by side: abc (2), def+changes (1).",
        "1 of 3 runs were made by changed code, not by that of a commit.",
    )
    assert [(one.runs, one.preset, one.threads, one.commit, one.rows) for one in found.origins] == [
        (2, "quick", "1", "abc", "ours"),
        (1, "smoke", "2", "def+changes", "fast"),
    ]
    text = (tmp_path / "out" / "report.md").read_text()
    assert text.index("different presets") < text.index("## Mean over")
    assert "| 2 | quick | 1 | abc | Abacus 2 | ours |\n" in text
    assert "different presets" in (tmp_path / "out" / "table.tex").read_text()


def test_runs_that_were_made_alike_are_compared_by_their_seconds_too() -> None:
    alike = {"preset": "quick", "threads": 1, "commit": "abc", "clean": True, "cpu": "Abacus 2"}
    runs = as_table([scored(row, "hat", seed, 1.0, **alike) for row in ("none", "ours") for seed in (0, 1)])
    assert warnings(runs) == []
    assert seconds_compare(runs)
    assert [(one.runs, one.rows) for one in origins(runs)] == [(4, "all")]
    assert not seconds_compare(runs.assign(cpu=["a", "a", "a", "b"]))
    assert not seconds_compare(runs.assign(threads=None)), "what nobody knows compares with nothing"


def test_a_row_whose_runs_differ_in_a_setting_is_named(write_run: Write) -> None:
    steps = {0: {"stage1_steps": 12}, 1: {"stage1_steps": 60, "pixels": 9}}
    folders = [
        put_setup(write_run(row, "hat", seed), {"seed": seed, "method": {"options": steps[seed if row == "mixed" else 0]}})
        for row in ("mixed", "one")
        for seed in (0, 1)
    ]
    assert mixed_rows(collect(folders).runs) == [
        "mixed: its runs are not of one configuration, so that its means mix them: method.options.stage1_steps (12, 60), "
        "method.options.pixels (nothing, 9)"
    ]


def test_seed_scene_threads_and_the_run_behind_a_score_make_no_other_configuration(write_run: Write) -> None:
    folders = []
    for scene, seed in (("hat", 0), ("hat", 1), ("ship", 0)):
        own = {"seed": seed, "scene": {"name": scene}, "threads": 1 + seed, "rescored_from": f"{scene}{seed}"}
        folders.append(put_setup(write_run("ours", scene, seed), own))
    folders.append(write_run("ours", "drum"))  # without any configuration
    assert mixed_rows(collect(folders).runs) == []


def test_of_many_settings_that_differ_the_first_are_named(write_run: Write) -> None:
    folders = [put_setup(write_run("ours", "hat", seed), dict.fromkeys("abcdefgh", seed)) for seed in (0, 1)]
    (sentence,) = mixed_rows(collect(folders).runs)
    assert sentence.endswith("d (0, 1), e (0, 1) and 3 more")
