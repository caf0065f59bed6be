"""The map of gains in a real browser: undecided cells are hatched, and a cell says what it is made of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ia_bench.cli import report

TABLE = """
reference: none
captures: [{}, {views: 2}]
rows: [{name: none, overrides: []}, {name: kernel, overrides: []}]
"""
GAINS = {"": [[0.5, -0.7], [0.2, 0.2]], "2 views": [[3.0, 3.2], [3.1, 2.9]]}  # of kernel over none, by scene and seed


@pytest.fixture
def page(tmp_path: Path, write_run_below: Callable[..., Path], open_page: Callable[[Path], Any]) -> Any:
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


def test_undecided_cells_are_hatched_and_a_click_opens_the_numbers(page: Any) -> None:
    cells = page.locator("#worth .worth:not([data-away]) .gain")
    assert [cell.evaluate("cell => getComputedStyle(cell).backgroundImage !== 'none'") for cell in cells.all()] == [True, False]
    assert "undecided" in cells.nth(0).inner_text()
    cells.nth(1).click()
    assert page.locator("#evidence h2").inner_text() == "kernel, 2 views"


def test_another_metric_is_shown_and_a_cell_says_what_it_is_made_of(page: Any) -> None:
    shown = page.locator("#worth .worth:not([data-away])")
    assert shown.count() == 1
    page.locator("#worth-metrics").get_by_role("button", name="Roughness MSE").click()
    assert shown.get_attribute("data-key") == "roughness.mse"
    page.locator("#worth-metrics").get_by_role("button", name="Relighting PSNR").click()
    assert [text.split("\n")[0] for text in shown.locator(".gain").all_inner_texts()] == ["+0.05", "+3.05"]
    shown.locator(".gain").nth(1).hover()
    assert "kernel, 2 views: +3.05 dB over none, 2 views, which has 20.00" in page.locator("#tip").inner_text()
