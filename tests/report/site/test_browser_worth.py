"""The map of gains in a real browser: undecided cells are hatched, and a cell opens its pictures by mouse and by keyboard.

The pictures are plain ones of a known grey, one a row, in the place of those that a report draws: what matters is which are opened.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ia_bench.cli import report
from ia_bench.report.collect import Runs
from ia_bench.report.site.content import Gallery
from ia_bench.runs.pictures import packing

KINDS = ("albedo", "aligned", "roughness", "view", "relit", "turned", "light")
TABLE = """
reference: none
captures: [{}, {views: 2}]
rows: [{name: none, overrides: []}, {name: kernel, overrides: []}]
"""
GAINS = {"": [[0.5, -0.7], [0.2, 0.2]], "2 views": [[3.0, 3.2], [3.1, 2.9]]}  # of kernel over none, by scene and seed


def hang_greys(runs: Runs, parts: Path) -> Gallery:
    """One grey picture of every kind for each row of the scene s1; none of them has recovered a light, so there is no view."""
    rows = list(dict.fromkeys(runs["row"]))
    sheets, errors, described = {kind: [1, 1] for kind in KINDS}, np.zeros((32, 32), np.uint8), {}
    for place, row in enumerate(("truth", *rows)):
        folder = parts / "s1" / str(place if row in rows else row)
        folder.mkdir(parents=True)
        for kind in (*KINDS, "photograph"):
            (folder / f"{kind}.webp").write_bytes(packing.sheet([np.full((96, 96, 3), 0.2 * place)]))
        content = {"tile": 32, "levels": packing.LEVELS, "largest": packing.LARGEST}
        maps = dict.fromkeys(("albedo", "aligned", "roughness", "relit"), packing.error_sheet([errors]))
        (folder / "errors.js").write_bytes(packing.script(f"s1/{folder.name}/errors", {**content, "sheets": maps}))
        has = {kind: shape for kind, shape in sheets.items() if kind not in ("view", "light")}
        described[row] = {"folder": folder.name, "sheets": has, "scores": dict.fromkeys(("albedo", "aligned", "relit"), [21.0])}
    del described["truth"]
    views = {"albedo": ["v0"], "view": ["v0"]}
    truth = {
        "folder": "s1",
        "sheets": {**sheets, "photograph": [1, 1]},
        "lights": ["sky"],
        "relit": [["sky", "v0"]],
        "views": views,
    }
    return Gallery(scenes={"s1": {**truth, "rows": described}})


@pytest.fixture
def page(
    tmp_path: Path, write_run_below: Callable[..., Path], open_page: Callable[[Path], Any], monkeypatch: pytest.MonkeyPatch
) -> Any:
    for label in GAINS:
        for scene in range(2):
            for seed in range(2):
                for row, psnr in {"none": 20.0, "kernel": 20.0 + GAINS[label][scene][seed]}.items():
                    name = f"{row}, {label}" if label else row
                    write_run_below(tmp_path, name, f"s{scene}", seed, psnr)
    (tmp_path / "ways.yaml").write_text(TABLE)
    monkeypatch.setattr(report, "draw_pictures", lambda runs, parts, note: hang_greys(runs, parts))
    table = str(tmp_path / "ways.yaml")
    assert report.main([str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--table", table]) == 0
    return open_page(tmp_path / "out" / "page")


def opened(page: Any) -> list[str]:
    page.wait_for_function("bench.look.scene")
    return [page.locator(f"#look-{side}").input_value() for side in ("left", "right", "of")] + [page.evaluate("bench.look.kind")]


def test_a_click_on_a_cell_of_the_map_opens_the_pictures_of_both_rows(page: Any) -> None:
    """They are of the one scene that has some, though it is not the first."""
    cells = page.locator("#worth .worth:not([data-away]) .gain")
    assert [cell.evaluate("cell => getComputedStyle(cell).backgroundImage !== 'none'") for cell in cells.all()] == [True, False]
    assert "undecided" in cells.nth(0).inner_text()
    cells.nth(1).click()
    assert opened(page) == ["none, 2 views", "kernel, 2 views", "kernel, 2 views", "aligned"]
    assert page.evaluate("bench.look.scene") == "s1"
    page.wait_for_function("Math.abs(document.querySelector('#look').getBoundingClientRect().top) < 300")
    assert page.locator("#evidence").is_hidden()
    assert "dB" in page.locator("#look-rows figure", has_text="kernel, 2 views").inner_text()


def test_another_metric_is_shown_and_a_cell_says_what_it_is_made_of(page: Any) -> None:
    shown = page.locator("#worth .worth:not([data-away])")
    assert shown.count() == 1
    page.locator("#worth-metrics").get_by_role("button", name="Roughness MSE").click()
    assert shown.get_attribute("data-key") == "roughness.mse"
    page.locator("#worth-metrics").get_by_role("button", name="Relighting PSNR").click()
    assert [text.split("\n")[0] for text in shown.locator(".gain").all_inner_texts()] == ["+0.05", "+3.05"]
    shown.locator(".gain").nth(1).hover()
    assert "kernel, 2 views: +3.05 dB over none, 2 views, which has 20.00" in page.locator("#tip").inner_text()
