"""Gains, photographs and their intervals: against numbers worked out by hand, and the bootstrap against coverage that is known."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from matplotlib.textpath import TextPath
from scored_runs import lines_of, scored

from ia_bench.report.collect import Collection, Record, Runs, as_table
from ia_bench.report.findings import analyse
from ia_bench.report.value import _draw, write_value
from ia_bench.report.worth import gains, maps, replicates, worth
from ia_bench.runs.table import Row, Table

TABLE = Table(
    rows=[Row("ceiling", ["method=ceiling"], captures=[""]), Row("none", []), Row("kernel", [])],
    reference="none",
    captures=[{"views": 2}, {"views": 8}, {}, {"views": 8, "radiometry": "ldr"}],
    photographs=32,
)
LEVELS = {"2 views": 10.0, "8 views": 20.0, "": 24.0, "8 views, LDR": 18.0}  # of none, dB


def run(row: str, scene: str, seed: int, value: float) -> Record:
    return scored(row, scene, seed, value, roughness_mse=value / 1000)


def records(gained: dict[str, list[list[float]]]) -> list[Record]:
    """``none`` as in LEVELS on every scene, and ``kernel`` above it by gained[label][scene][seed]."""
    found = [run("ceiling", f"s{scene}", seed, 34.0) for scene in range(2) for seed in range(2)]
    for label, scenes in gained.items():
        end = f", {label}" if label else ""
        for scene, seeds in enumerate(scenes):
            for seed, gain in enumerate(seeds):
                found += [run(f"none{end}", f"s{scene}", seed, LEVELS[label])]
                found += [run(f"kernel{end}", f"s{scene}", seed, LEVELS[label] + gain)]
    return found


def runs(gained: dict[str, list[list[float]]]) -> Runs:
    return as_table(records(gained))


def write(found: Runs, table: Table, out: Path) -> set[str]:
    return {path.name for path in write_value(analyse(Collection(found), table), out)}


GAINED = {"2 views": [[5.0, 5.0], [5.0, 5.0]], "8 views": [[1.0, 3.0], [2.0, 2.0]], "": [[-1.0, 0.5], [0.3, 0.6]],
          "8 views, LDR": [[0.0, 0.0], [0.0, 0.0]]}  # fmt: skip


def test_gains_are_means_over_scenes_of_means_over_seeds_and_positive_is_better() -> None:
    found = {(gain.capture, gain.metric.key): gain for gain in gains(runs(GAINED), TABLE)}
    assert found["8 views", "aligned_albedo.psnr"].mean == pytest.approx(2.0)
    assert found["8 views", "aligned_albedo.psnr"].beside == pytest.approx(20.0)
    assert found["8 views", "roughness.mse"].mean == pytest.approx(-0.002), "more error is a loss"
    assert found["2 views", "aligned_albedo.psnr"].outcome == "gains"
    assert found["2 views", "roughness.mse"].outcome == "costs"
    assert found["", "aligned_albedo.psnr"].outcome == "undecided"
    assert {gain.row for gain in found.values()} == {"kernel"}


def test_a_row_needs_the_photographs_that_the_references_curve_says() -> None:
    found = {(one["capture"], one["photographs"], one["metric"]): one for one in worth(runs(GAINED), TABLE)}
    two, eight, every = (found["", count, "aligned_albedo.psnr"] for count in (2, 8, 32))
    assert two["needed"] == pytest.approx(2 ** (1 + 2 * 0.5)), "15 dB lie half way between 2 and 8 photographs in the logarithm"
    assert (two["low"], two["high"]) == (pytest.approx(4.0), pytest.approx(4.0))
    assert eight["needed"] == pytest.approx(2 ** (3 + 2 * 0.5)), "22 dB, half way between 8 and 32"
    assert every["needed"] == math.inf, "24.1 dB: the reference does not get there"
    assert every["low"] < 32
    assert ("LDR", 8, "aligned_albedo.psnr") not in found, "one number of photographs makes no curve"
    below = worth(runs(GAINED | {"2 views": [[-1.0, -1.0], [-1.0, -1.0]]}), TABLE)
    assert next(one["needed"] for one in below if one["photographs"] == 2) == 0, "the fewest are better"


def test_photographs_are_those_recorded_and_some_captures_are_read_off_the_whole_curve() -> None:
    """A table made for scenes of 32 photographs, run on scenes of 128: 22 dB then lie half way between 8 and 128."""
    recorded = runs(GAINED)
    recorded["photographs"] = [2 if "2 views" in row else 8 if "8" in row else 128 for row in recorded["row"]]
    found = {one["photographs"]: one for one in worth(recorded, TABLE) if one["metric"] == "aligned_albedo.psnr"}
    assert [*found] == [2, 8, 128]
    assert found[8]["needed"] == pytest.approx(2 ** (3 + 4 * 0.5))
    some = replace(TABLE, captures=TABLE.captures[:3], rows=[*TABLE.rows[:2], Row("kernel", [], captures=["2 views"])])
    without = as_table(one for one in records(GAINED) if one["row"] not in ("kernel, 8 views", "kernel"))
    found = [one for one in worth(without, some) if one["metric"] == "aligned_albedo.psnr"]
    assert [(one["row"], one["photographs"]) for one in found] == [("kernel", 2)]
    assert found[0]["needed"] == pytest.approx(4.0)


def test_every_number_of_photographs_takes_the_seeds_that_it_has() -> None:
    first = as_table(one for one in records(GAINED) if (one["row"], one["seed"]) != ("kernel, 2 views", 1))
    found = {one["photographs"]: one for one in worth(first, TABLE) if one["metric"] == "aligned_albedo.psnr"}
    everything = {one["photographs"]: one for one in worth(runs(GAINED), TABLE) if one["metric"] == "aligned_albedo.psnr"}
    assert found[8] == everything[8], "with 8 photographs no seed is missing"
    assert found[2]["needed"] == pytest.approx(4.0)
    assert [(count, found[count]["scenes"], found[count]["pairs"]) for count in (2, 8)] == [(2, 2, 2), (8, 2, 4)]


def test_bootstrap_adds_the_variance_of_both_levels_and_draws_runs_as_wholes() -> None:
    generator = np.random.default_rng(3)
    scenes = [generator.normal(mean, 2.0, 30) for mean in generator.normal(0, 1.0, 40)]
    drawn = replicates(scenes, 20_000)
    means = np.array([scene.mean() for scene in scenes])
    expected = means.var() / 40 + np.mean([scene.var() / 30 for scene in scenes]) / 40
    assert drawn.var() == pytest.approx(expected, rel=0.06)  # six standard errors: sqrt(2 / 20000) is .01
    drawn = replicates([np.array([[1.0, 10.0], [2.0, 20.0]]), np.array([[3.0, 30.0]])], 100)
    np.testing.assert_allclose(drawn[:, 1], 10 * drawn[:, 0])


def test_files_say_what_was_found(tmp_path: Path) -> None:
    assert write(runs(GAINED), TABLE, tmp_path) == {"value.md", "value.csv", "photographs.csv", "value.png", "value.svg"}
    page = (tmp_path / "value.md").read_text()
    assert "| 2 views | 10.00 | **+5.00 (+5.00 to +5.00)** |" in page
    assert "| all views | 24.00 | +0.10 (" in page
    assert "Decided is what survives Holm's correction at 5 % among all cells of one metric" in page
    base = lines_of(tmp_path / "value.csv", "capture", "metric")["all views", "aligned_albedo.psnr"]
    assert base["decided"] == "undecided"
    means = np.array([-0.25, 0.45])
    t_975, t_80 = 12.7062047, 1.3763819  # of Student's distribution with one degree of freedom, from a table
    assert float(base["detectable"]) == pytest.approx((t_975 + t_80) * means.std(ddof=1) / math.sqrt(2), rel=1e-6)


def test_names_of_scenes_are_no_markup(tmp_path: Path) -> None:
    write(as_table(one | {"scene": f"*{one['scene']}*"} for one in records({"2 views": [[1.0], [1.1]]})), TABLE, tmp_path)
    assert r"Scenes: \*s0\*, \*s1\*. " in (tmp_path / "value.md").read_text()


def test_what_is_decided_only_alone_is_marked_and_eight_scenes_have_a_sign_test(tmp_path: Path) -> None:
    """Gains of 1 dB and a deviation that gives p = .03: alone enough, among four captures not."""
    some = [1.0 + 1.05 * (-1) ** scene for scene in range(8)]
    gained = {label: [[gain] for gain in some] for label in LEVELS}
    write(runs(gained), TABLE, tmp_path)
    page = (tmp_path / "value.md").read_text()
    assert "| 2 views | 10.00 | +1.00 ° (" in page
    assert "; 4/8 p 1) |" in page
    base = lines_of(tmp_path / "value.csv", "capture", "metric")["2 views", "aligned_albedo.psnr"]
    assert (base["decided"], base["scenes_above"], base["sign_test_p_value"]) == ("undecided, decided alone", "4", "1.0")
    assert float(base["p_value"]) == pytest.approx(scipy.stats.ttest_1samp(some, 0).pvalue, rel=1e-6)
    width = float(base["half_width_over_scenes"])
    assert float(base["half_width_new_scene"]) == pytest.approx(3 * width), "sqrt(1 + 1/n) over sqrt(1/n), of eight scenes"


def test_a_row_that_lacks_a_scene_decides_nothing() -> None:
    found = records({"2 views": [[1.0], [1.1], [1.2]]})
    assert [one.survives for one in gains(as_table(found), TABLE) if one.metric.key == "aligned_albedo.psnr"] == [True]
    some = [one for one in found if (one["row"], one["scene"]) != ("kernel, 2 views", "s0")]
    (gain,) = [one for one in gains(as_table(some), TABLE) if one.metric.key == "aligned_albedo.psnr"]
    assert (gain.p_value, gain.outcome, gain.alone) == (None, "undecided", False)


def test_a_reference_that_lacks_a_scene_decides_nothing_either_and_the_cell_says_so(tmp_path: Path) -> None:
    found = records({"2 views": [[1.0], [1.1], [1.2]]})
    some = as_table([one for one in found if (one["row"], one["scene"]) != ("none, 2 views", "s0")])
    (gain,) = [one for one in gains(some, TABLE) if one.metric.key == "aligned_albedo.psnr"]
    assert (gain.p_value, gain.outcome, gain.alone) == (None, "undecided", False)
    write(some, TABLE, tmp_path)
    assert "2/3 scenes)" in (tmp_path / "value.md").read_text()


def test_the_level_of_the_reference_is_that_of_all_its_runs_whichever_row_stands_first(tmp_path: Path) -> None:
    """The kernel, the first row, has one seed of each scene, the other row both: the reference has 10 and 20, 30 and 40 dB."""
    table = Table(rows=[Row("none", []), Row("kernel", []), Row("other", [])], reference="none", captures=[{}, {"views": 8}])
    levels = {("s0", 0): 10.0, ("s0", 1): 20.0, ("s1", 0): 30.0, ("s1", 1): 40.0}
    some = [run(row, *cell, level) for cell, level in levels.items() for row in ("none", "other")]
    some += [run("kernel", scene, 0, level + 1) for (scene, seed), level in levels.items() if seed == 0]
    write(as_table(some), table, tmp_path)
    page = (tmp_path / "value.md").read_text()
    assert "| all views | 25.00 | +1.00 (+1.00 to +1.00)" in page.replace("**", "")
    assert "The column `none` is its level over all of its runs" in page
    records = lines_of(tmp_path / "value.csv", "row", "capture", "metric")
    assert [float(records[row, "all views", "relighting.psnr"]["reference"]) for row in ("kernel", "other")] == [20.0, 25.0], (
        "what each was compared with"
    )


def test_without_a_metric_in_decibels_there_is_no_figure_and_without_pairs_nothing(tmp_path: Path) -> None:
    rough = runs(GAINED).assign(aligned_albedo_psnr=math.nan, relighting_psnr=math.nan)
    assert write(rough, TABLE, tmp_path) == {"value.md", "value.csv"}
    assert write(as_table([run("none", "s0", 0, 1.0)]), TABLE, tmp_path / "out") == set()
    assert not (tmp_path / "out").exists()
    assert gains(runs(GAINED), replace(TABLE, captures=[])) == [], "scenes that are photographed in one way"


def test_the_heat_map_can_be_read_in_a_page_of_800_pixels() -> None:
    """With eight rows, as the published one: digits are 9 pixels tall there, and a number stays in its cell."""
    table = replace(TABLE, rows=[Row("none", []), *(Row(f"kernel {n}, four times the steps", []) for n in range(8))])
    gained = {label: [[-0.25, -0.35], [0.85, 0.95]] for label in LEVELS}
    found = [one | {"row": str(one["row"]).replace("kernel", row.name)} for row in table.rows[1:] for one in records(gained)]
    shown = [one for one in maps(gains(as_table(found), table)) if one.metric.label == "PSNR"]
    assert [len(one.rows) for one in shown] == [8, 8]
    figure = _draw(shown)
    figure.set_dpi(800 / figure.get_figwidth())
    figure.draw_without_rendering()
    cell = figure.axes[0].get_window_extent().width / 8
    assert figure.axes[0].get_window_extent().y0 > figure.axes[1].get_window_extent().y1, "one below the other"
    texts = [text for panel in figure.axes for text in (*panel.texts, *panel.get_xticklabels(), *panel.get_yticklabels())]
    assert len(texts) > 2 * 2 * 8 * len(LEVELS)
    for text in texts:
        nine = TextPath((0, 0), "0", size=text.get_fontsize() * figure.dpi / 72).get_extents()
        assert nine.height >= 9, text.get_text()
        assert text.axes is figure.axes[2] or text.get_window_extent().width < cell or text in text.axes.get_yticklabels()


def test_a_row_stands_for_the_papers_where_no_photograph_is_left_out() -> None:
    """Else a part of the report compares with the paper, and has no line."""
    rows = [replace(row, paper="Ours") if row.name == "kernel" else row for row in TABLE.rows]
    collection = Collection(as_table([run("kernel, 8 views", "hat", 0, 20.0)]))
    for captures, expected in (([{"views": 8}], []), ([{"views": 8}, {}], ["kernel"])):
        findings = analyse(collection, replace(TABLE, rows=rows, captures=captures))
        assert list(findings.counterparts) == expected
        assert bool(findings.paper) == bool(expected)
