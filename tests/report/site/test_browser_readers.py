"""The page in a real browser, opened from disk: in the dark, on a phone, on paper, and without scripts.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


def test_dark_light_and_the_systems_colours(page: Any) -> None:
    ground = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(ground)
    page.emulate_media(color_scheme="dark")
    dark = page.evaluate(ground)
    assert light != dark
    page.locator("#theme").click()
    assert page.evaluate(ground) == light
    page.locator("#theme").click()
    assert page.evaluate(ground) == dark


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


def test_on_paper_every_scene_stands_below_the_other(page: Any) -> None:
    page.emulate_media(media="print")
    assert [page.locator(f"#scope-{place}").is_visible() for place in range(3)] == [True, True, True]
    assert page.locator(".tools").first.is_hidden()


def test_text_is_there_before_any_script(browser: Any, page_folder: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    opened = context.new_page()
    opened.goto((page_folder / "index.html").as_uri())
    assert "21.50" in opened.locator("#scope-0 tr[data-row='none']").inner_text()
    context.close()
