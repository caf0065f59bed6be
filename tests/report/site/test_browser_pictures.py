"""The page in a real browser, opened from disk: pictures under the slider, errors, turned lights and objects.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

ALBEDO = 0.25  # of the row "grey", everywhere


def pixel(page: Any, selector: str, x: float = 0.5, y: float = 0.5) -> list[int]:
    """A pixel of a picture as it is painted: canvases of files from disk cannot be read by scripts."""
    element = page.locator(selector)
    element.scroll_into_view_if_needed()
    image = Image.open(io.BytesIO(element.screenshot())).convert("RGB")
    return list(image.getpixel((int(x * (image.width - 1)), int(y * (image.height - 1)))))


def look(page: Any, kind: str = "Albedo") -> None:
    page.locator("#look").scroll_into_view_if_needed()
    page.wait_for_function("bench.look.scene")
    page.locator("#look-kinds").get_by_role("button", name=kind, exact=True).click()
    page.wait_for_timeout(300)


def test_the_slider_uncovers_one_picture_and_covers_the_other(page: Any) -> None:
    look(page)
    page.locator("#look-left").select_option("truth")
    page.locator("#look-right").select_option("grey")
    page.locator("#look-slider").focus()
    shown = []
    for key in ("ArrowLeft", "ArrowRight"):
        page.keyboard.down(key)
        page.wait_for_timeout(1500)
        page.keyboard.up(key)
        shown.append(pixel(page, "#look-slider", 0.5, 0.55))
    encoded = round(255 * (1.055 * ALBEDO ** (1 / 2.4) - 0.055))
    assert np.abs(np.array(shown[0]) - encoded).max() <= 8  # the row's grey, as a lossy picture has it
    assert np.abs(np.array(shown[1]) - shown[0]).max() > 8


def test_the_error_under_the_cursor_is_that_of_the_textures(page: Any) -> None:
    look(page)
    page.locator("#look-of").select_option("grey")
    page.wait_for_timeout(300)
    heat = page.locator("#look-heat")
    heat.scroll_into_view_if_needed()
    heat.hover(position={"x": 2, "y": 2})
    assert page.locator("#look-value").inner_text() == "not scored"
    box = heat.bounding_box()
    heat.hover(position={"x": box["width"] / 2, "y": box["height"] * 0.55})
    assert "dB" in page.locator("#look-value").inner_text()
    page.locator("#look-of").select_option("ceiling")
    page.wait_for_timeout(300)
    heat.hover(position={"x": box["width"] / 2, "y": box["height"] * 0.5})
    value = page.locator("#look-value").inner_text()
    assert value.startswith("below") or float(value.split()[0]) < 0.02  # the truth itself, up to its texels' interpolation
    heat.focus()
    page.keyboard.press("ArrowLeft")
    assert page.locator("#look-value").inner_text()


def test_views_are_stepped_through_chosen_and_named(page: Any) -> None:
    look(page)
    page.get_by_role("button", name="Next view").click()
    assert page.locator("#look-view").inner_text().startswith("2 of 4")
    page.locator("#look-views button").nth(3).click()
    assert page.locator("#look-view").inner_text().startswith("4 of 4")
    page.get_by_role("button", name="View before").click()
    assert page.locator("#look-view").inner_text().startswith("3 of 4")
    page.locator("#look-kinds").get_by_role("button", name="Relit").click()
    assert " under " in page.locator("#look-view").inner_text()
    assert "photograph" not in page.locator("#look-left").inner_text()


def test_zoom_and_drag_move_the_same_part_in_every_row(page: Any) -> None:
    look(page)
    page.locator("#look-zoom").fill("4")
    assert page.evaluate("bench.crop()") == [0.375, 0.375, 0.25]
    first = page.locator("#look-rows canvas").first
    first.scroll_into_view_if_needed()
    box = first.bounding_box()
    page.mouse.move(box["x"] + 80, box["y"] + 80)
    page.mouse.down()
    page.mouse.move(box["x"] + 80 - box["width"] / 2, box["y"] + 80, steps=4)
    page.mouse.up()
    assert page.evaluate("bench.crop()")[0] == pytest.approx(0.5, abs=0.01)  # half a picture of a quarter
    first.focus()
    page.keyboard.press("ArrowDown")
    assert page.evaluate("bench.crop()")[1] == pytest.approx(0.4, abs=0.01)
    assert page.locator("#look-rows figure").count() == 4  # photograph, truth, two rows


def test_the_light_has_no_error_map(page: Any) -> None:
    look(page, "Light")
    assert page.locator("#look-error").is_hidden()
    assert page.locator("#look-rows figure").count() == 3


def test_a_light_is_turned_by_slider_and_by_dragging(page: Any) -> None:
    page.locator("#relight").scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    before = pixel(page, "#relight canvas >> nth=0", 0.5, 0.6)
    page.locator("#relight-turn").fill("8")
    assert page.locator("#relight-angle").inner_text() == "180°"
    page.wait_for_timeout(200)
    assert pixel(page, "#relight canvas >> nth=0", 0.5, 0.6) != before
    box = page.locator("#relight canvas").nth(1).bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"], box["y"] + 50, steps=4)
    page.mouse.up()
    assert page.locator("#relight-angle").inner_text() == "0°"  # half a picture is half a turn


def test_the_object_turns_and_shows_one_channel_under_another_light(page: Any) -> None:
    page.locator("#turn").scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('#turn-stage').dataset.shown", timeout=60_000)
    before = page.evaluate("document.querySelector('model-viewer').getCameraOrbit().theta")
    box = page.locator("model-viewer").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 420, box["y"] + 200, steps=5)
    page.mouse.up()
    turned = f"Math.abs(document.querySelector('model-viewer').getCameraOrbit().theta - {before}) > 0.1"
    page.wait_for_function(turned, timeout=20_000)
    for name, choice in (("row", "grey"), ("channel", "roughness"), ("light", "studio"), ("channel", "lit")):
        page.locator(f"#turn-{name}").select_option(choice)
        page.wait_for_function(f"document.querySelector('#turn-stage').dataset.shown.includes('{choice}')", timeout=20_000)
