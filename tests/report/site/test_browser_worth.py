"""The map of gains in a real browser: undecided cells are hatched, and a cell opens its pictures by mouse and by keyboard.

The pictures are plain ones of a known grey, one a row, in the place of those that a report draws: what matters is which are opened.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ia_bench.cli import report
from ia_bench.report.collect import Run
from ia_bench.report.site.gallery import Gallery
from ia_bench.runs.pictures import packing

KINDS = ("albedo", "aligned", "roughness", "view", "relit", "turned", "light")
CAPTURES: dict[str, dict[str, Any]] = {"": {}, "2 views": {"views": 2}}
GAINS = {"": [[0.5, -0.7], [0.2, 0.2]], "2 views": [[3.0, 3.2], [3.1, 2.9]]}  # of kernel over none, by scene and seed


def hang_greys(runs: Sequence[Run], parts: Path) -> Gallery:
    """One grey picture of every kind for each row of the scene s1; none of them has recovered a light, so there is no view."""
    rows = list(dict.fromkeys(run.row for run in runs))
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
    for label, settings in CAPTURES.items():
        for scene in range(2):
            for seed in range(2):
                for row, psnr in {"none": 20.0, "kernel": 20.0 + GAINS[label][scene][seed]}.items():
                    name = f"{row}, {label}" if label else row
                    run = partial(write_run_below, tmp_path, capture={"views": settings.get("views", 64)})(
                        name, f"s{scene}", seed, psnr
                    )
                    config = {"scene": {"name": f"s{scene}"}} | ({"capture": settings} if settings else {})
                    (run / "config.json").write_text(json.dumps({"config": config}))
    monkeypatch.setattr(report, "_pictures", lambda written, parts: hang_greys(written.findings.runs, parts))
    assert report.main([str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--reference", "none"]) == 0
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


@pytest.mark.parametrize("key", ["Enter", "Space"])
def test_the_keyboard_opens_them_too(page: Any, key: str) -> None:
    page.locator("#worth-metrics").get_by_role("button", name="Aligned albedo PSNR").click()
    page.locator("#worth .worth:not([data-away]) .gain").nth(0).focus()
    assert "over none, which has" in page.locator("#tip").inner_text()
    page.keyboard.press(key)
    assert opened(page) == ["none", "kernel", "kernel", "aligned"]


def test_rows_without_a_light_are_not_offered_where_one_is_needed(page: Any) -> None:
    page.locator("#worth .worth:not([data-away]) .gain").nth(1).click()
    page.wait_for_function("bench.look.scene")
    page.locator("#look-kinds").get_by_role("button", name="View synthesis").click()
    assert page.locator("#look-right option").all_inner_texts() == ["truth"]
    assert page.locator("#look-rows figure").count() == 1
    page.locator("#look-kinds").get_by_role("button", name="Albedo", exact=True).click()
    assert page.locator("#look-rows figure").count() == 6  # photograph, truth, four rows
