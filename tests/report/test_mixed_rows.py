"""Rows whose runs are not of one configuration are named, so that nobody takes their means for those of one."""

from collections.abc import Callable
from pathlib import Path

from scored_runs import put_setup

from ia_bench.report.collect import collect
from ia_bench.report.findings import analyse

Write = Callable[..., Path]


def test_a_row_whose_runs_differ_in_a_setting_is_named(write_run: Write) -> None:
    steps = {0: {"stage1_steps": 12}, 1: {"stage1_steps": 60, "pixels": 9}}
    folders = [
        put_setup(write_run(row, "hat", seed), {"seed": seed, "method": {"options": steps[seed if row == "mixed" else 0]}})
        for row in ("mixed", "one")
        for seed in (0, 1)
    ]
    assert list(analyse(collect(folders)).notes) == [
        "mixed: its runs are not of one configuration, so that its means mix them: method.options.stage1_steps (12, 60), "
        "method.options.pixels (nothing, 9)"
    ]


def test_scenes_with_readers_of_their_own_are_of_one_configuration(write_run: Write) -> None:
    def notes(*readings: tuple[str, dict[str, int]]) -> str:
        """What is said of ``hat``, read natively, beside a run of ``mug`` for each of the readings."""
        cells = [("hat", 0, ("native", {})), *(("mug", seed, reading) for seed, reading in enumerate(readings))]
        folders = [
            put_setup(write_run("ours", scene, seed), {"reader": {"name": name, "options": options}})
            for scene, seed, (name, options) in cells
        ]
        return "".join(analyse(collect(folders)).notes)

    assert not notes(("colmap", {}))
    assert "means mix them: mug: reader.name ('colmap', 'llff')" in notes(("colmap", {}), ("llff", {}))
    assert "mug: reader.options.every (nothing, 4)" in notes(("colmap", {}), ("colmap", {"every": 4}))
