"""The page in a real browser, opened from disk: pictures under the slider, errors, turned lights and objects.

Every test also fails for a message on the console and for a request that leaves the folder. Without Chromium or Playwright
everything here is skipped, visibly: conftest.py says what brings them.
"""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ia_bench.cli.report import main

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
    page.wait_for_function("document.querySelector('#turn-stage').dataset.shown", timeout=1_200_000)
    before = page.evaluate("document.querySelector('model-viewer').getCameraOrbit().theta")
    box = page.locator("model-viewer").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 420, box["y"] + 200, steps=5)
    page.mouse.up()
    turned = f"Math.abs(document.querySelector('model-viewer').getCameraOrbit().theta - {before}) > 0.1"
    page.wait_for_function(turned, timeout=1_200_000)
    for name, choice in (("row", "grey"), ("channel", "roughness"), ("light", "studio"), ("channel", "lit")):
        page.locator(f"#turn-{name}").select_option(choice)
        page.wait_for_function(f"document.querySelector('#turn-stage').dataset.shown.includes('{choice}')", timeout=1_200_000)


def test_photographs_of_ones_own_are_shown_without_a_truth(
    open_page: Callable[[Path], Any],
    perfect_run: Path,
    tiny_copy: Path,
    put_on_scene: Callable[[Path, Path], None],
    keep_pictures: Callable[..., None],
    write_run: Callable[..., Path],
    tmp_path: Path,
) -> None:
    """No map of the light, no textures, no maps of held-out views: what is left is offered, and nothing that is not there."""
    description = json.loads((tiny_copy / "scene.json").read_text())
    kept = {key: value for key, value in description.items() if key not in ("truth_textures", "lights", "splits")}
    (tiny_copy / "scene.json").write_text(json.dumps(kept))
    for split in ("train", "test", "novel"):
        path = tiny_copy / f"transforms_{split}.json"
        transforms = json.loads(path.read_text())
        frames = [frame for frame in transforms["frames"] if frame.get("light", "train") == "train"]
        bare = [{key: frame[key] for key in ("file_path", "transform_matrix")} for frame in frames]
        path.write_text(json.dumps(transforms | {"frames": bare}))
    put_on_scene(perfect_run, tiny_copy)
    run = write_run("perfect", "tiny", files={f"{name}.exr": name for name in ("albedo", "roughness", "light")}, albedo_scales={},
        protocol_description={"lpips": {"net": "alex"}, "alignment": "mean_rgb"})  # fmt: skip
    for name in ("albedo.exr", "roughness.exr", "light.exr", "config.json"):
        (run / name).write_bytes((perfect_run / name).read_bytes())
    keep_pictures(run)
    assert main([str(run), "--out", str(tmp_path / "out")]) == 0
    page = open_page(tmp_path / "out" / "page")
    look(page, "View synthesis")
    tabs = [tab.inner_text() for tab in page.locator("#look-kinds button").all() if tab.is_visible()]
    assert tabs == ["Albedo", "Roughness", "View synthesis", "Light"]
    assert page.locator("#look-left").inner_text().split() == ["photograph", "perfect"]
    assert page.locator("#look-error").is_visible()
    page.locator("#look-kinds").get_by_role("button", name="Albedo", exact=True).click()
    page.get_by_role("button", name="Next view").click()
    assert page.locator("#look-view").inner_text().startswith("2 of 2")
    assert page.locator("#look-error").is_hidden()
    page.locator("#look-kinds").get_by_role("button", name="Light", exact=True).click()
    assert page.locator("#look-rows figure").count() == 1
    assert page.locator("#relight").count() == 0
    page.locator("#turn").scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('#turn-stage').dataset.shown", timeout=1_200_000)
    assert page.locator("#turn-row").inner_text().split() == ["perfect"]
    assert page.locator("#turn-light").inner_text().split() == ["recovered"]
