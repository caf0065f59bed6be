"""The page in a real browser, opened from disk: error against run time.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from __future__ import annotations

from typing import Any


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


def test_dragging_across_a_plot_zooms_into_time(page: Any) -> None:
    curves(page)
    box = page.locator(".plot .u-over").nth(1).bounding_box()
    before = page.evaluate("bench.plots.plots[1].scales.x.max")
    page.mouse.move(box["x"] + 40, box["y"] + 120)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 120, steps=4)
    page.mouse.up()
    assert page.evaluate("bench.plots.plots[1].scales.x.max") < before


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


def test_rows_with_curves_differ_in_colour(page: Any) -> None:
    """Colours go to the rows that have curves, so that a row far down in the table does not take one that is in use."""
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_selector("#curve-rows .chip")
    colours = page.evaluate("bench.drawn.map((row) => bench.styleOf(row).colour)")
    assert len(colours) == len(set(colours)) == 2
    assert page.evaluate("bench.styleOf(bench.drawn[0]).colour === bench.colours[0]")
