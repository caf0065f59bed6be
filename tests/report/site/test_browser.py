"""The page in a real browser, opened from disk: the table and what is behind its numbers, error against run time, gains.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ia_bench.cli import report
from ia_bench.report.collect import collect
from ia_bench.report.findings import analyse
from ia_bench.report.site.page import write_page

AIR = 5  # pixels between a mark's middle and the frame, so that the largest mark is whole


def rows(page: Any, scope: int = 0) -> list[str]:
    return page.eval_on_selector_all(f"#scope-{scope} tbody tr:not(.part)", "rows => rows.map(row => row.dataset.row)")


def test_sorting_puts_the_better_first_then_the_worse_then_as_it_came(page: Any) -> None:
    came = rows(page)
    head = page.locator("#scope-0 [data-sort='relighting.psnr']")
    seen = []
    for _ in range(3):
        head.click()
        seen.append((rows(page), page.locator("#scope-0 th[data-key='relighting.psnr']").get_attribute("aria-sort")))
    better = ["ceiling", "grey", "none", "constant"]
    assert seen == [(better, "descending"), (better[::-1], "ascending"), (came, "none")]


def test_tabs_change_the_scene_also_by_arrow_keys(page: Any) -> None:
    page.get_by_role("tab", name="hat").click()
    assert page.locator("#scope-1").is_visible()
    assert page.locator("#scope-0").is_hidden()
    page.keyboard.press("ArrowRight")
    assert page.locator("#scope-2").is_visible()
    assert page.locator("#scope-2 tr[data-row='none'] td").nth(9).inner_text().startswith("22.50")


def test_a_tooltip_says_what_a_column_means_by_mouse_and_by_keyboard(page: Any) -> None:
    head = page.locator("#scope-0 [data-sort='relighting.psnr']")
    head.hover()
    assert "lights that no method has seen" in page.locator("#tip").inner_text()
    page.keyboard.press("Escape")
    assert page.locator("#tip").is_hidden()
    page.locator("#scope-0 [data-sort='roughness.mse']").focus()
    assert "Lower is better" in page.locator("#tip").inner_text()


def test_behind_a_number_are_its_seeds_and_the_keyboard_gets_there_and_back(page: Any) -> None:
    number = page.locator("#scope-0 tr[data-row='none'] td").first
    number.focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    dialog = page.locator("#evidence")
    assert dialog.is_visible()
    assert dialog.locator("h2").inner_text() == rows(page)[rows(page).index("none") - 1]
    page.keyboard.press("Escape")
    assert dialog.is_hidden()
    number.click()
    heads = dialog.locator("details.run > summary").all_inner_texts()
    assert heads == ["hat, seed 0: 20.00", "hat, seed 1: 21.00", "tiny, seed 0: 22.00", "tiny, seed 1: 23.00"]
    assert "null" not in dialog.inner_text()
    dialog.get_by_role("button", name="Close").click()
    assert dialog.is_hidden()


@pytest.mark.parametrize("how", ["fold", "sort", "hide"])
def test_the_keyboard_gets_into_the_table_after_the_number_it_was_at_has_gone(page: Any, how: str) -> None:
    page.locator("#all-metrics").check()
    page.locator("#scope-0 .unfold").first.click()
    page.locator("#scope-0 tbody td").first.focus()
    page.keyboard.press("ArrowDown")  # to a scene of the row
    page.keyboard.press("ArrowRight")  # to one of the metrics that are shown on request
    if how == "fold":
        page.locator("#scope-0 .unfold").first.click()
    elif how == "sort":
        page.locator("#scope-0 [data-sort='relighting.psnr']").click()
    else:
        page.locator("#all-metrics").uncheck()
    reached = page.locator("#scope-0 tbody td[tabindex='0']")
    assert reached.count() == 1
    assert reached.is_visible()


def test_from_the_best_row_of_a_scene_to_its_pictures(page: Any) -> None:
    page.get_by_role("tab", name="tiny").click()
    page.locator("#scope-2 .leaders .who[data-key='relighting.psnr']").click()
    assert page.locator("#evidence h2").inner_text() == "grey"
    page.get_by_role("button", name="Look at it: tiny").click()
    assert page.evaluate("[bench.look.scene, bench.look.kind]") == ["tiny", "relit"]
    assert page.locator("#look-right").input_value() == "grey"


# ---- for other readers: in the dark, on a phone, on paper, without scripts ----
def test_on_a_phone_nothing_but_the_table_is_wider_than_the_window(page: Any) -> None:
    """The narrowest phone in use; also with pictures, plots and the numbers behind a cell."""
    page.set_viewport_size({"width": 360, "height": 740})
    wide = "document.documentElement.scrollWidth"
    for part in ("table", "look", "relight", "turn", "curves", "notes"):
        page.locator(f"#{part}").scroll_into_view_if_needed()
        page.wait_for_timeout(100)
        assert page.evaluate(wide) <= 360, part
    page.locator("#scope-0 tr[data-row='none'] td").first.click()
    assert page.evaluate(wide) <= 360
    assert page.eval_on_selector("#evidence", "box => box.scrollWidth <= box.clientWidth && box.clientWidth <= 360")
    page.keyboard.press("Escape")
    assert page.eval_on_selector("#scope-0 .scroller", "box => box.scrollWidth > box.clientWidth")


def test_text_is_there_before_any_script(browser: Any, page_folder: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    opened = context.new_page()
    opened.goto((page_folder / "index.html").as_uri())
    assert "21.50" in opened.locator("#scope-0 tr[data-row='none']").inner_text()
    context.close()


# ---- error against run time ----
def curves(page: Any) -> None:
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_function("bench.plots && bench.plots.plots.length === 5")


def test_a_mark_beside_the_pareto_front_tells_its_row_and_leads_to_its_numbers(page: Any) -> None:
    page.locator("#seconds").scroll_into_view_if_needed()
    page.wait_for_function("bench.pareto.plot !== null")
    at = page.evaluate("""() => {
      const { plot, metric } = bench.pareto, row = bench.data.pareto[0].rows.find((one) => one.row === "grey");
      const over = plot.over.getBoundingClientRect();
      return [over.left + plot.valToPos(row.cost, "x"), over.top + plot.valToPos(row.scores[metric.key], "y")];
    }""")
    page.mouse.move(*at)
    told = page.locator(".readout:visible").inner_text().split("\n")
    assert told == ["grey", "seconds", "1.00 × none", "Aligned albedo PSNR ↑", "25.50"]
    page.mouse.click(*at)
    assert page.locator("#evidence-title").inner_text() == "grey"


def test_gains_stand_in_the_table_and_sort_by_the_largest(page: Any) -> None:
    gains = [page.locator("#scope-0 tr[data-row='grey'] td").nth(place).inner_text().split()[0] for place in (-5, -4)]
    assert gains == ["+4.00", "+4.00"]
    page.locator("#scope-0 [data-sort='gain']").click()
    assert rows(page)[0] == "grey"
    page.locator("#scope-0 tr[data-row='grey'] td").nth(-5).click()
    assert "Aligned albedo PSNR" in page.locator("#evidence .where").inner_text()


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


# ---- what a prior is worth ----
TABLE = """
reference: none
captures: [{}, {views: 2}]
rows: [{name: none, overrides: []}, {name: kernel, overrides: []}]
"""
GAINS = {"": [[0.5, -0.7], [0.2, 0.2]], "2 views": [[3.0, 3.2], [3.1, 2.9]]}  # of kernel over none, by scene and seed


@pytest.fixture
def ways(tmp_path: Path, write_run_below: Callable[..., Path], open_page: Callable[[Path], Any]) -> Any:
    for label in GAINS:
        for scene in range(2):
            for seed in range(2):
                for row, psnr in {"none": 20.0, "kernel": 20.0 + GAINS[label][scene][seed]}.items():
                    name = f"{row}, {label}" if label else row
                    write_run_below(tmp_path, name, f"s{scene}", seed, psnr)
    (tmp_path / "ways.yaml").write_text(TABLE)
    table = str(tmp_path / "ways.yaml")
    assert report.main([str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--table", table]) == 0
    return open_page(tmp_path / "out" / "page")


def test_undecided_cells_are_hatched_and_a_click_opens_the_numbers(ways: Any) -> None:
    cells = ways.locator("#worth .worth:not([data-away]) .gain")
    assert [cell.evaluate("cell => getComputedStyle(cell).backgroundImage !== 'none'") for cell in cells.all()] == [True, False]
    assert "undecided" in cells.nth(0).inner_text()
    cells.nth(1).click()
    assert ways.locator("#evidence h2").inner_text() == "kernel, 2 views"


def test_another_metric_is_shown_and_a_cell_says_what_it_is_made_of(ways: Any) -> None:
    shown = ways.locator("#worth .worth:not([data-away])")
    assert shown.count() == 1
    ways.locator("#worth-metrics").get_by_role("button", name="Roughness MSE", exact=True).click()
    assert shown.get_attribute("data-key") == "roughness.mse"
    ways.locator("#worth-metrics").get_by_role("button", name="Relighting PSNR", exact=True).click()
    assert [text.split("\n")[0] for text in shown.locator(".gain").all_inner_texts()] == ["+0.05", "+3.05"]
    shown.locator(".gain").nth(1).hover()
    assert "kernel, 2 views: +3.05 dB over none, 2 views, which has 20.00" in ways.locator("#tip").inner_text()
