"""The page in a real browser, opened from disk as a reader opens it: sorted, slid, turned, zoomed, read, copied.

Compared are what the page shows and the numbers of the run folders that it was made from. Every test also fails for a message on
the console and for a request that leaves the folder. Without Chromium or Playwright everything here is skipped, visibly:
``apt-get install chromium`` and ``pip install playwright`` (extra ``browser``) bring them.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ia_bench.cli.report import main
from ia_bench.common.paths import scenes_folder
from ia_bench.readers.native import NativeReader
from ia_bench.runs.config import NATIVE_READER
from ia_bench.scenes.exr import write_exr

ALBEDO = 0.25  # of the row "grey", everywhere
PSNR = {"ceiling": 40.0, "constant": 10.0, "none": 20.0, "grey": 24.0}


def curve(seed: int) -> str:
    """Relighting rises from 10 to 20 dB, which it reaches after 9 s, or 10 s of the second seed."""
    points = ((step, 10 + step / 9 * 5, 10 + step / 9 * 10, 0.2 / (1 + step)) for step in (1, 3, 9))
    return "".join(f"final,{step},{step + seed},{albedo},12,13,{relit},{error}\n" for step, albedo, relit, error in points)


@pytest.fixture(scope="module")
def page_folder(
    write_run_below: Callable[..., Path], put_on_scene: Callable[..., None], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Four rows on two scenes; two rows have textures on the scene ``tiny``: the truth, and one grey."""
    root = tmp_path_factory.mktemp("browser")
    write = partial(write_run_below, root)
    scene = scenes_folder() / "tiny"
    truth = NativeReader(scene).read(truth=True).truth
    assert truth is not None
    assert truth.albedo is not None
    textures = {"ceiling": truth.albedo, "grey": np.full_like(truth.albedo, ALBEDO)}
    for row, psnr in PSNR.items():
        for seed in (0, 1):
            bound = row in ("ceiling", "constant")
            points = f"final,0,0,{psnr},{psnr},{psnr},{psnr},0.01\n" if bound else curve(seed)
            of = {"mean_rgb": [1.0] * 3}
            description = {"protocol_description": {"lpips": {"net": "alex"}, "alignment": "mean_rgb"}, "albedo_scales": of}
            files = {f"{name}.exr": row + name for name in ("albedo", "roughness", "light")}
            for name, better in (("hat", 0.0), ("tiny", 2.0)):
                run = write(row, name, seed, psnr=psnr + better + seed, curve=points, sees_truth=bound, files=files, **description)
                if row in textures and name == "tiny":
                    write_exr(run / "albedo.exr", textures[row], half=False)
                    write_exr(run / "roughness.exr", truth.roughness, half=False)
                    write_exr(run / "light.exr", truth.lights["train"], half=False)
                    config = {"reader": {"name": "native", "target": NATIVE_READER, "options": {"uv": "mesh"}}, "seed": seed}
                    (run / "config.json").write_text(json.dumps({"config": {**config, "render": {"coat": "layered"}}}))
                    put_on_scene(run, scene)
    assert main([str(root / "runs"), "--out", str(root / "out"), "--reference", "none"]) == 0
    return root / "out" / "page"


@pytest.fixture
def page(open_page: Callable[[Path], Any], page_folder: Path) -> Any:
    return open_page(page_folder)


def rows(page: Any, scope: int = 0) -> list[str]:
    return page.eval_on_selector_all(f"#scope-{scope} tbody tr:not(.part)", "rows => rows.map(row => row.dataset.row)")


def pixel(page: Any, selector: str, x: float = 0.5, y: float = 0.5) -> list[int]:
    """A pixel of a picture as it is painted: canvases of files from disk cannot be read by scripts."""
    element = page.locator(selector)
    element.scroll_into_view_if_needed()
    image = Image.open(io.BytesIO(element.screenshot())).convert("RGB")
    return list(image.getpixel((int(x * (image.width - 1)), int(y * (image.height - 1)))))


# ---- the table ---------------------------------------------------------------------------------------------------------


def test_sorting_puts_the_better_first_then_the_worse_then_as_it_came(page: Any) -> None:
    came = rows(page)
    head = page.locator("#scope-0 [data-sort='relighting.psnr']")
    seen = []
    for _ in range(3):
        head.click()
        seen.append((rows(page), page.locator("#scope-0 th[data-key='relighting.psnr']").get_attribute("aria-sort")))
    better = ["ceiling", "grey", "none", "constant"]
    assert seen == [(better, "descending"), (better[::-1], "ascending"), (came, "none")]


def test_where_less_is_better_the_least_comes_first_and_names_sort_too(page: Any) -> None:
    page.locator("#scope-0 [data-sort='roughness.mse']").click()
    assert page.locator("#scope-0 th[data-key='roughness.mse']").get_attribute("aria-sort") == "ascending"
    page.locator("#scope-0 [data-sort='row']").click()
    assert rows(page) == sorted(PSNR)


def test_tabs_change_the_scene_also_by_arrow_keys(page: Any) -> None:
    page.get_by_role("tab", name="hat").click()
    assert page.locator("#scope-1").is_visible()
    assert page.locator("#scope-0").is_hidden()
    page.keyboard.press("ArrowRight")
    assert page.locator("#scope-2").is_visible()
    assert page.locator("#scope-2 tr[data-row='none'] td").nth(9).inner_text().startswith("22.50")


def test_a_row_unfolds_into_its_scenes_and_folds_again(page: Any) -> None:
    unfold = page.get_by_role("button", name="none, scene by scene")
    unfold.click()
    assert page.locator("#scope-0 tr.part").all_inner_texts()[0].startswith("hat")
    assert page.locator("#scope-0 tr.part").count() == 2
    unfold.click()
    assert page.locator("#scope-0 tr.part").count() == 0


def test_a_tooltip_says_what_a_column_means_by_mouse_and_by_keyboard(page: Any) -> None:
    head = page.locator("#scope-0 [data-sort='relighting.psnr']")
    head.hover()
    assert "lights that no method has seen" in page.locator("#tip").inner_text()
    page.keyboard.press("Escape")
    assert page.locator("#tip").is_hidden()
    page.locator("#scope-0 [data-sort='roughness.mse']").focus()
    assert "Lower is better" in page.locator("#tip").inner_text()


def test_all_metrics_are_shown_when_asked_for(page: Any) -> None:
    ssim = page.locator("#scope-0 th[data-key='albedo.ssim']")
    assert ssim.is_hidden()
    page.locator("#all-metrics").check()
    assert ssim.is_visible()


@pytest.mark.parametrize(
    ("form", "line"),
    [("CSV", "none,21.5,21.5,21.5,21.5,0.05,"), ("Markdown", "| none | 21.50 ± "), ("LaTeX", r"none & 21.50 $\pm$ ")],
)
def test_the_table_is_copied_as_it_is_shown(page: Any, form: str, line: str) -> None:
    """The mean of 20, 21, 22 and 23 dB."""
    page.get_by_role("button", name=form, exact=True).click()
    page.wait_for_function("bench.copied")
    copied = page.evaluate("bench.copied")
    assert any(text.startswith(line) for text in copied.splitlines())
    assert "ssim" not in copied.lower()


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


def test_a_run_that_left_its_folder_is_linked_with_its_command(page: Any, page_folder: Path) -> None:
    page.get_by_role("tab", name="tiny").click()
    page.locator("#scope-2 tr[data-row='grey'] td").first.click()
    link = page.locator("#evidence details.run[open] a")
    assert (page_folder / link.get_attribute("href") / "metrics.json").resolve().is_file()


# ---- curves ------------------------------------------------------------------------------------------------------------


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


# ---- pictures ----------------------------------------------------------------------------------------------------------


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


# ---- other readers -----------------------------------------------------------------------------------------------------


def test_from_the_best_row_of_a_scene_to_its_pictures(page: Any) -> None:
    page.get_by_role("tab", name="tiny").click()
    page.locator("#scope-2 .leaders .who[data-key='relighting.psnr']").click()
    assert page.locator("#evidence h2").inner_text() == "grey"
    page.get_by_role("button", name="Look at it: tiny").click()
    assert page.evaluate("[bench.look.scene, bench.look.kind]") == ["tiny", "relit"]
    assert page.locator("#look-right").input_value() == "grey"


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
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
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
