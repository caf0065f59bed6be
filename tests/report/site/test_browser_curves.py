"""The page in a real browser, opened from disk: error against run time.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ia_bench.report.collect import collect
from ia_bench.report.findings import analyse
from ia_bench.report.site.page import write_page

AIR = 5  # pixels between a mark's middle and the frame, so that the largest mark is whole


def curves(page: Any) -> None:
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_function("bench.plots && bench.plots.plots.length === 5")


def test_one_cursor_for_all_plots_and_its_values_beside_it(page: Any) -> None:
    curves(page)
    over = page.locator(".plot .u-over")
    over.nth(0).hover(position={"x": 120, "y": 80})
    assert "none" in page.locator(".readout").inner_text()
    places = page.evaluate("bench.plots.plots.map(plot => plot.cursor.idx)")
    assert len(set(places)) == 1
    assert places[0] is not None


def test_a_row_is_hidden_and_time_is_linear_when_asked_for(page: Any) -> None:
    curves(page)
    page.locator(".chip", has_text="none").click()
    assert page.evaluate("bench.plots.plots[0].series.filter(one => one.show).length") == 10  # time, and three of each other row
    page.locator("#curve-time").select_option("linear")
    assert page.evaluate("bench.plots.plots[0].scales.x.distr") == 1
    page.locator("#curve-value").select_option("linear")
    assert page.evaluate("bench.plots.plots[4].scales.y.distr") == 1


def test_the_handle_tells_when_a_level_was_first_measured(page: Any) -> None:
    curves(page)
    handle = page.get_by_role("slider", name="Level of Relighting PSNR ↑")
    handle.focus()
    for _ in range(80):
        page.keyboard.press("ArrowUp")
    assert "never" in page.locator("#levels li").first.inner_text()
    for _ in range(10):
        page.keyboard.press("ArrowDown")
    level = float(handle.get_attribute("aria-valuenow"))
    assert 14 < level <= 20  # the last measured point alone is there: after 9 s and 10 s
    assert "9.5 s" in page.locator("#levels li").first.inner_text()
    box = handle.bounding_box()
    page.mouse.move(box["x"] + 60, box["y"] + 7)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 60, steps=3)
    page.mouse.up()
    assert float(handle.get_attribute("aria-valuenow")) < level


@pytest.fixture
def short_page(open_page: Callable[[Path], Any], write_run: Callable[..., Path], tmp_path: Path) -> Any:
    """A page of one row that was measured once, at the very start, and another one that takes less than a decade of time."""
    write = partial(write_run, scene="hat")
    folders = [write("none", curve="final,1,1.5,20,20,20,20,0.1\n")]
    folders.append(write("ours", curve="final,1,2,21,21,21,21,0.09\nfinal,2,4.5,22,22,22,22,0.08\n"))
    folder = write_page(analyse(collect(folders)), "short", tmp_path / "page").parent
    opened = open_page(folder)
    curves(opened)
    return opened


@pytest.mark.parametrize("time", ["log", "linear"])
@pytest.mark.parametrize("name", ["page", "short_page"])
def test_the_frame_cuts_no_mark(name: str, time: str, request: pytest.FixtureRequest) -> None:
    opened = request.getfixturevalue(name)
    curves(opened)
    opened.locator("#curve-time").select_option(time)
    room = opened.evaluate("""() => bench.plots.plots.flatMap((plot, place) => bench.data.runs
      .filter((run) => run.scene === bench.plots.scene && run.curve && !run.curve.level)
      .flatMap(({ curve }) => curve.seconds.flatMap((seconds, at) => {
        const [x, y] = [plot.valToPos(seconds, "x"), plot.valToPos(curve.values[place][at], "y")];
        return [x, plot.over.clientWidth - x, y, plot.over.clientHeight - y];
      })))""")
    assert len(room) >= 5 * 3 * 4  # plots, points, sides
    assert min(room) >= AIR


def test_nothing_is_dashed_once_all_runs_have_finished(page: Any, dashes: Callable[[Any], list[list[float]]]) -> None:
    """Not even the second row, nor ceiling and floor: dashes are for runs that go on (test_live_page)."""
    curves(page)
    assert page.locator(".chip").count() == 2
    assert dashes(page) == []
