"""The page in a real browser, opened from disk: the table sorted, unfolded, explained, copied, and what is behind its numbers.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


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
