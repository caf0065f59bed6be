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


def test_a_scene_under_whose_name_different_files_were_read_is_named(write_run: Write) -> None:
    """Two rows were run before the scene was rendered again, one of them after it, too; a former run does not say what it read."""
    read = [("ours", 0, "a"), ("none", 0, "a"), ("none", 1, "b"), ("theirs", 0, "b"), ("former", 0, None)]
    folders = [
        put_setup(write_run(row, "hat", seed), {"scene": {"name": "hat", "content": content}} if content else {})
        for row, seed, content in read
    ]
    ship = [put_setup(write_run(row, "ship"), {"scene": {"name": "ship", "content": "c"}}) for row in ("ours", "none")]
    assert list(analyse(collect([*folders, *ship])).notes) == [
        "hat: its runs have read different files under this name, so that they do not compare: none, ours / none, theirs"
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
