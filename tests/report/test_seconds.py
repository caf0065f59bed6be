"""Gains at equal seconds and the Pareto front, against numbers worked out by hand."""

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest
from scipy.stats import ttest_1samp
from scored_runs import lines_of, scored

from ia_bench.report import seconds
from ia_bench.report.collect import Record, as_table
from ia_bench.report.curves import draw_pareto
from ia_bench.report.seconds import WORTH_METRICS, Timing, best_after, points, seconds_records, seconds_table, timing
from ia_bench.report.write import write_report
from ia_bench.runs.table import Row, Table
from ia_bench.scores.metrics import METRIC_OF

ALBEDO, ROUGHNESS = WORTH_METRICS[0], METRIC_OF["roughness.mse"]
TABLE = Table(
    rows=[Row(name, []) for name in ("none", "twice", "four times", "ours", "slow")],
    reference="none",
    curve=["twice", "four times"],
)
SPENT = {"none": 10.0, "twice": 20.0, "four times": 40.0, "ours": 10 * math.sqrt(8), "slow": 80.0}
SAME = {"cpu": "Abacus 2", "threads": 1, "commit": "0" * 40}
HIGH = {"none": 20.0, "twice": 22.0, "four times": 21.0, "ours": 25.0, "slow": 26.0}  # steps cost it after a while
RISING = {"none": 20.0, "twice": 22.0, "four times": 26.0, "ours": 25.0, "slow": 26.0}


def run(row: str, scene: str, seed: int, value: float, **more: object) -> Record:
    spent = {"seconds": SPENT[row], "cpu_seconds": SPENT[row]}
    return scored(row, scene, seed, value, **{"roughness_mse": 1 / value, **spent, **SAME, **more})


def records(seeds: int = 1, **more: object) -> list[Record]:
    return [
        run(row, scene, seed, value, **more)
        for scene, levels in (("falls", HIGH), ("rises", RISING))
        for row, value in levels.items()
        for seed in range(seeds)
    ]


def clocked(found: list[Record], table: Table = TABLE) -> Timing:
    return timing(as_table(found), table, table.reference)


@pytest.mark.parametrize(
    ("cost", "best"),
    [
        (0.5, 10.0),  # before the cheapest: what that has
        (1.0, 10.0),
        (2.0, 12.0),  # half way between 1 and 4 in the logarithm; 2 itself is worse than 1
        (4.0, 14.0),
        (8.0, 14.5),
        (16.0, 15.0),
        (99.0, 15.0),  # after the dearest: the best
    ],
)
def test_the_best_so_far_is_straight_in_the_logarithm_between_what_is_better_than_all_before(cost: float, best: float) -> None:
    assert best_after([(4.0, 14.0), (1.0, 10.0), (2.0, 9.0), (16.0, 15.0), (32.0, 3.0)], cost) == pytest.approx(best)


def test_gains_at_equal_seconds_are_taken_scene_by_scene_and_less_error_is_better() -> None:
    """``ours`` takes sqrt(8) times as long, half way from twice to four times as long in the logarithm: 22 dB, and 24 dB."""
    found = clocked(records()).compared(ALBEDO)
    assert found["ours"].gain.pairs == {"falls": {0: 5.0}, "rises": {0: 5.0}}
    assert found["ours"].equal.pairs["falls"][0] == pytest.approx(3.0)
    assert found["ours"].equal.pairs["rises"][0] == pytest.approx(1.0)
    assert found["none"].equal.pairs == {"falls": {0: 0.0}, "rises": {0: 0.0}}
    assert found["four times"].equal.pairs == {"falls": {0: -1.0}, "rises": {0: 0.0}}, "twice as long was better"
    assert (found["ours"].beyond, found["four times"].beyond, found["slow"].beyond) == (False, False, True)
    assert found["slow"].equal.pairs == {"falls": {0: 4.0}, "rises": {0: 0.0}}
    found = clocked(records()).compared(ROUGHNESS)
    between = (1 / 22 + 1 / 26) / 2
    assert found["ours"].equal.pairs["rises"][0] == pytest.approx(between - 1 / 25)
    assert found["ours"].front


def test_scenes_and_seeds_count_that_the_whole_curve_has() -> None:
    some = [one for one in records(2) if (one["row"], one["seed"]) != ("twice", 1)]
    found = clocked(some).compared(ALBEDO)
    assert found["ours"].gain.count == 4
    assert found["ours"].equal.count == 2
    assert {seed for seeds in found["ours"].equal.pairs.values() for seed in seeds} == {0}
    some = [one for one in records() if one["row"] != "four times"]  # a row of the curve that nobody has run is none of it
    assert clocked(some).compared(ALBEDO)["slow"].equal.pairs == {"falls": {0: 4.0}, "rises": {0: 4.0}}


def test_a_scene_on_which_the_reference_failed_is_missing_like_one_on_which_the_row_did() -> None:
    for lacking in ("none", "ours"):
        some = [one for one in records() if (one["row"], one["scene"]) != (lacking, "falls")]
        found = clocked(some).compared(ALBEDO)["ours"]
        assert (found.judged, found.front, found.score) == (False, False, None), lacking


def test_the_front_is_what_nobody_beats_in_less_time() -> None:
    found = clocked(records()).compared(ALBEDO)
    assert [row for row, one in found.items() if one.front] == ["none", "twice", "ours", "slow"]
    assert found["four times"].score == pytest.approx(23.5)
    seen = [one | {"sees_truth": one["row"] == "ours"} for one in records()]
    found = clocked(seen).compared(ALBEDO)
    assert [row for row, one in found.items() if one.front] == ["none", "twice", "four times", "slow"], "the truth is no competitor"
    assert found["ours"].gain.count == 2
    few = [one for one in records() if (one["row"], one["scene"]) != ("ours", "falls")]
    assert clocked(few).compared(ALBEDO)["ours"].score is None, "a row that lacks a scene is not ranked"


def test_cpu_seconds_count_where_every_run_has_them_then_costs_of_the_table_then_the_wall_clock() -> None:
    assert clocked(records()).counted == seconds.CPU
    busy = [one | {"seconds": 1000.0} for one in records()]
    assert clocked(busy).clocks[0].costs["twice"] == pytest.approx(2.0)
    former = [one | ({"cpu_seconds": None} if one["row"] == "none" else {}) for one in records()]
    assert clocked(former).counted == seconds.WALL
    costs = {"none": 2.0, "twice": 3.0, "ours": 4.0}
    stated = replace(TABLE, rows=[replace(row, cost=costs.get(row.name)) for row in TABLE.rows])
    time = clocked(former, stated)
    assert time.counted == seconds.STATED
    assert time.clocks[0].costs == {"none": 1.0, "twice": 1.5, "ours": 2.0}
    assert time.clocks[0].curve == ("none", "twice")
    partly = clocked(former, replace(TABLE, rows=[replace(row, cost=4.0 if row.name == "ours" else None) for row in TABLE.rows]))
    assert (partly.counted, partly.clocks[0].costs["none"]) == (seconds.WALL, 1.0), "of the reference it states none"


def test_the_first_sentence_says_what_spoils_the_comparison() -> None:
    assert clocked(records()).told.startswith("Seconds are CPU seconds of the runs: baking, prior and all steps")
    assert "the best of “none” (1.00), “twice” (2.00), “four times” (4.00)" in clocked(records()).told
    mixed = [one | ({"commit": "1" * 40} if one["row"] == "ours" else {}) | {"threads": None} for one in records()]
    first = clocked(mixed).told.split(": ")[0]
    assert first == "Runs differ or may differ in threads (unknown) and commit (000000000000, 111111111111)"
    changed = [one | {"commit": "0" * 40 + "+changes" if one["row"] == "ours" else "0" * 12} for one in records()]
    assert clocked(changed).told.startswith("Runs differ or may differ in commit (000000000000, 000000000000+changes): ")
    assert clocked([one | {"commit": "0" * (12 + one["seed"])} for one in records()]).told.startswith("Seconds are ")
    alike = {"ours": "Intel(R) Xeon(R) 8481C"}
    cpus = [one | {"cpu": alike.get(str(one["row"]), "Intel(R) Xeon(R) 8370C")} for one in records()]
    assert clocked(cpus).told.startswith("Runs differ or may differ in cpu (Intel(R) Xeon(R) 8370C, Intel(R) Xeon(R) 8481C): ")
    alone = clocked(records(), replace(TABLE, curve=[]))
    assert "“none” was not run with more work" in alone.told
    assert alone.compared(ALBEDO)["ours"].beyond


def test_seconds_of_others_and_rows_without_a_run_of_the_reference_are_left_out() -> None:
    more = [
        *records(),
        run("ours", "elsewhere", 0, 30.0) | {"row": "alone"},
        run("ours", "falls", 0, 30.0) | {"row": "brought", "declared": "yes"},
    ]
    assert set(clocked(more).clocks[0].costs) == set(SPENT)
    lines = {cells[0]: cells[1:4] for cells in seconds_table(clocked(more), 2).body}
    assert lines["brought"] == ["–", "+10.00 (1/2)", "–"], "what it gains is known all the same"
    assert timing(as_table(records()), replace(TABLE, reference=None), None) is None
    assert timing(as_table(records(seconds=0.0)), TABLE, "none") is None


def test_the_report_has_the_table_the_picture_and_the_numbers(tmp_path: Path) -> None:
    report = write_report([], tmp_path, TABLE, records(2))
    text = (tmp_path / "report.md").read_text()
    assert "| ours | 2.83 | +5.00 ± 0.00 / 0.00 / 0.00 | +2.00 ± 0.00 / 12.71 / 22.01 | yes |" in text
    assert "| slow | 8.00 | +6.00 ± 0.00 / 0.00 / 0.00 | +2.00 ± 0.00 / 25.41 / 44.02 \\> | yes |" in text
    assert "| none | 1.00 | – | – | yes |" in text
    assert {"pareto.png", "pareto.svg", "seconds.csv"} <= {path.name for path in report.files}
    ours = lines_of(tmp_path / "seconds.csv", "row", "metric")["ours", "aligned_albedo.psnr"]
    assert (float(ours["equal_seconds"]), ours["front"], ours["beyond_curve"]) == (pytest.approx(2.0), "True", "False")
    write_report([], tmp_path, replace(TABLE, reference=None, curve=[]), records(2))
    assert not (tmp_path / "pareto.png").exists(), "of a former report"


def test_a_report_without_these_scores_compares_no_seconds(tmp_path: Path) -> None:
    """As one of photographs alone, of which neither albedo nor relighting is known."""
    blank = {metric.column: math.nan for metric in WORTH_METRICS}
    write_report([], tmp_path, TABLE, records(**blank))
    assert "pareto" not in (tmp_path / "report.md").read_text()
    assert not (tmp_path / "seconds.csv").exists()


def test_the_picture_has_rows_from_the_cheapest_to_the_dearest() -> None:
    found = points(clocked(records()))
    assert [row["row"] for row in found[0]["rows"]] == sorted(SPENT, key=SPENT.__getitem__)
    figure = draw_pareto(found, list(SPENT))
    assert [panel.get_title() for panel in figure.axes] == ["Aligned albedo PSNR", "Relighting PSNR"]
    dashed = next(line for line in figure.axes[0].lines if line.get_label() == "none with more work")
    assert list(dashed.get_xdata()) == [1.0, 2.0, 4.0]
    cheap = run("ours", "falls", 0, 30.0) | {"row": "cheap", "seconds": 1e-4, "cpu_seconds": 1e-4}
    assert points(clocked([*records(), cheap | {"scene": "rises"}, cheap]))[0]["rows"][0]["cost"] == pytest.approx(1e-5)
    assert draw_pareto([], []) is None
    for panel in figure.axes:
        boxes = [text.get_window_extent() for text in panel.texts]
        assert len(boxes) == len(SPENT)
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2)), "names that hide each other"


def test_what_is_decided_at_equal_seconds_is_so_among_all_rows_that_the_curve_judges() -> None:
    """p = .037 of 1, 2 and 1.4 dB in three scenes is decided alone, and not beside another row."""
    gained = {"none": (0.0,) * 3, "four times": (0.0,) * 3, "ours": (1.0, 2.0, 1.4), "slow": (-1.0, 1.0, 0.1)}

    def told(some: list[Record]) -> dict[str, tuple[float | None, bool | None]]:
        found = [one for one in seconds_records(clocked(some)) if one["metric"] == ALBEDO.key]
        return {one["row"]: (one["equal_seconds_p_value"], one["equal_seconds_decided"]) for one in found}

    def made(seconds: float) -> list[Record]:
        slow = {"seconds": seconds, "cpu_seconds": seconds}
        return [
            run(row, f"s{place}", 0, 20.0 + more, **(slow if row == "slow" else {}))
            for row, each in gained.items()
            for place, more in enumerate(each)
        ]

    p_value = pytest.approx(ttest_1samp(gained["ours"], 0).pvalue)
    both = told(made(40.0))
    assert both["ours"] == (p_value, False)
    assert both["slow"][1] is False
    assert both["none"] == both["four times"] == (None, None)
    alone = told(made(50.0))  # longer than the curve: what the reference has then is not known
    assert (alone["ours"], alone["slow"]) == ((p_value, True), (None, None))
    less = [one for one in made(50.0) if (one["row"], one["scene"]) != ("ours", "s0")]
    assert told(less)["ours"] == (None, None), "a row that lacks a scene"


def test_rows_of_the_curve_that_were_not_run_are_named_with_captures_that_lack_them() -> None:
    some = [one for one in records() if one["row"] != "twice"]
    assert "Without “twice”, which the table names for that and which was not run" in clocked(some).told
    assert "Without" not in clocked(records()).told
    table = replace(TABLE, captures=[{"views": 8}, {}])
    ends = {row: [", 8 views", *([""] if row != "twice" else [])] for row in SPENT}
    told = clocked([one | {"row": one["row"] + end} for one in records() for end in ends[one["row"]]], table).told
    assert "“four times” (4.00) (as they are with 8 views)" in told
    assert "Without “twice”, which the table names for that and which was not run or not timed with all views, gains" in told


def test_a_table_states_one_cost_of_a_row_or_one_for_each_capture() -> None:
    apart = {"none": 2.0, "twice": {"8 views": 3.0, "": 4.0}, "ours": {"": 6.0}}
    rows = [replace(row, cost=apart.get(row.name)) for row in TABLE.rows]
    table = replace(TABLE, captures=[{"views": 8}, {}], rows=rows)
    former = [one | {"row": one["row"] + end, "cpu_seconds": None} for one in records() for end in (", 8 views", "")]
    time = clocked(former, table)
    assert time.counted == seconds.STATED
    few, all_views = ({row.removesuffix(", 8 views"): cost for row, cost in clock.costs.items()} for clock in time.clocks)
    assert (few, all_views) == ({"none": 1.0, "twice": 1.5}, {"none": 1.0, "twice": 2.0, "ours": 3.0})


def test_the_table_of_captures_calls_rows_by_their_whole_names() -> None:
    table = replace(TABLE, captures=[{"views": 8}], rows=[*TABLE.rows, Row("constant", [])])
    some = [one | {"row": f"{one['row']}, 8 views"} for one in records()]
    some.append(some[0] | {"row": "constant, 8 views", "cpu_seconds": 0.0})  # a bound takes no seconds that compare
    time = clocked(some, table)
    printed = seconds_table(time, 2)
    assert printed.header[1] == "Seconds / none"
    assert [cells[0] for cells in printed.body] == [f"{row.name}, 8 views" for row in TABLE.rows]
    assert "“twice” (2.00)" in time.told
    assert time.counted == seconds.CPU
