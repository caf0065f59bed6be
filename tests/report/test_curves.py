"""What the figures of error against run time draw."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from ia_bench.report.collect import Runs, collect
from ia_bench.report.curves import draw_pareto, draw_scene, save
from ia_bench.report.write import write_report
from ia_bench.scores.metrics import CURVE_METRICS

Write = Callable[..., Path]
RISES = "stage1,0,0,10,10,10,10,0.1\nstage1,50,5,16,16,16,16,0.05\nstage2,100,20,24,24,24,24,0.01\n"
FALLS = "stage1,0,0,10,10,10,10,0.02\nstage1,50,5,18,18,18,18,0.05\nstage2,100,20,16,16,17.95,16,0.08\n"
CEILING = "ceiling,0,0,,,30,31,0.001\n"


@pytest.fixture
def runs(write_run: Write) -> Runs:
    """Two seeds of ours, one that rises more slowly, a falling none and a ceiling, all on hat."""
    slow = RISES.replace(",5,16", ",8,14.9").replace(",20,24,", ",30,19,")
    folders = [
        write_run("ours", "hat", 0, curve=RISES),
        write_run("ours", "hat", 1, curve=slow),
        write_run("none", "hat", 0, curve=FALLS),
        write_run("ceiling", "hat", 0, curve=CEILING),
        write_run("quiet", "hat", 0),
    ]
    return collect(folders).runs


def test_the_figure_shows_lines_bands_and_the_dashed_ceiling(runs: Runs) -> None:
    figure = draw_scene(runs, "hat", ["ceiling", "none", "ours", "quiet"])
    panels = {panel.get_title(): panel for panel in figure.axes}
    for metric in CURVE_METRICS:
        assert panels[metric.title].get_xscale() == "log"
    synthesis = panels["View synthesis PSNR ↑"]
    lines = {one.get_label(): one for one in synthesis.get_lines()}
    assert set(lines) == {"ceiling", "none", "ours"}
    assert lines["ceiling"].get_linestyle() == "--"
    assert set(lines["ceiling"].get_ydata()) == {30.0}
    np.testing.assert_array_equal(lines["none"].get_xdata(), [5, 20])  # the point at 0 s has no place on a log axis
    assert len(synthesis.collections) == 1  # the band of the two seeds
    shared = lines["ours"].get_xdata()
    assert (shared[0], shared[-1]) == pytest.approx((8, 20))  # where both seeds have been measured
    assert "ceiling" not in {one.get_label() for one in panels["Albedo PSNR ↑"].get_lines()}
    legend = [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
    assert legend == ["ceiling", "none", "ours"]


@pytest.mark.parametrize("name", ["cost_$a%$", "$$", "$x_"])
def test_dollar_signs_are_no_mathematics(write_run: Write, tmp_path: Path, name: str) -> None:
    """Which matplotlib takes them for, and raises at what is none."""
    drawn = draw_scene(collect([write_run(name, name, curve=RISES)]).runs, name, [name])
    row = {"row": name, "name": name, "cost": 1.0, "scores": {"albedo.psnr": 20.0}, "front": ["albedo.psnr"], "curve": False}
    front = draw_pareto(
        [{"capture": "", "reference": name, "rows": [row, row | {"row": "other", "name": "other", "cost": 2.0}]}], [name, "other"]
    )
    for figure in (drawn, front):
        (_, picture) = save(figure, tmp_path / "drawn")
        shown = [text for text in figure.findobj(Text) if "$" in text.get_text()]
        assert shown
        assert all(text._preprocess_math(text.get_text()) == (text.get_text().replace(r"\$", "$"), False) for text in shown)
        assert picture.stat().st_size > 0


def test_every_row_stands_in_the_legend_and_every_scene_has_a_figure_of_its_own(write_run: Write, tmp_path: Path) -> None:
    """matplotlib passes over labels that begin with _; in a file's name a blank becomes one."""
    scenes = {"my hat": RISES, "my_hat": FALLS}
    folders = [write_run(row, scene, curve=curve) for scene, curve in scenes.items() for row in ("none", "_mine")]
    figure = draw_scene(collect(folders).runs, "my hat", ["none", "_mine"])
    assert [text.get_text() for text in figure.axes[-1].get_legend().get_texts()] == ["none", "_mine"]
    drawn = [path for path in write_report(folders, tmp_path / "out").files if path.parent.name == "curves"]
    assert len({path.read_bytes() for path in drawn}) == len(drawn) == 4


def test_seeds_that_were_scored_once_each_are_marks(write_run: Write) -> None:
    """As with preset=smoke; a mean at common times has none, and the figure was empty."""
    once = [write_run("ours", "hat", seed, curve=f"final,18,{3 + seed},2{seed},20,20,20,0.1\n") for seed in range(2)]
    figure = draw_scene(collect(once).runs, "hat", ["ours"])
    lines = figure.axes[0].get_lines()
    assert [(*line.get_xdata(), *line.get_ydata()) for line in lines] == [(3, 20), (4, 21)]
    assert all(line.get_marker() == "o" for line in lines)
    assert len({line.get_color() for line in lines}) == 1


def test_pictures_are_the_same_bytes_each_time_and_the_mean_lies_between_its_seeds(runs: Runs, tmp_path: Path) -> None:
    contents = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        files = save(draw_scene(runs, "hat", ["none", "ours"]), tmp_path / name / "hat")
        assert [file.name for file in files] == ["hat.png", "hat.svg"]
        contents.append([file.read_bytes() for file in files])
    assert contents[0] == contents[1]
    figure = draw_scene(runs, "hat", ["ours"])
    line = figure.axes[0].get_lines()[0]
    last = line.get_ydata()[-1]  # at 20 s: 24 of one seed, the other on its way from 14.9 at 8 s to 19 at 30 s
    other = 14.9 + (19 - 14.9) * np.log(20 / 8) / np.log(30 / 8)
    assert last == pytest.approx((24 + other) / 2, abs=0.01)
