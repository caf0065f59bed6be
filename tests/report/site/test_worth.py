"""What a prior is worth, on the page: gains that are known by construction, and the map of them in a browser."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ia_bench.cli.report import main
from ia_bench.report.collect import collect
from ia_bench.report.site.worth import Map, maps
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.identity import identity
from ia_bench.runs.table import Row, Table

CAPTURES: dict[str, dict[str, Any]] = {
    "": {},
    "2 views": {"views": 2},
    "2 views, LDR": {"views": 2, "radiometry": "ldr"},
    "hull": {"geometry": "hull"},
}
GAINS = {  # of kernel over none, by scene and seed
    "": [[0.5, -0.7], [0.2, 0.2]],
    "2 views": [[3.0, 3.2], [3.1, 2.9]],
    "2 views, LDR": [[-1.0, -1.2], [-1.1, -0.9]],
}


@pytest.fixture
def runs(tmp_path: Path, write_run_below: Callable[..., Path]) -> Path:
    """none and kernel with each capture; with a hull there is none alone, so no gain."""
    write = partial(write_run_below, tmp_path)
    for label, settings in CAPTURES.items():
        for scene in range(2):
            for seed in range(2):
                rows = {"none": 20.0} | ({"kernel": 20.0 + GAINS[label][scene][seed]} if label in GAINS else {})
                for row, psnr in rows.items():
                    name = f"{row}, {label}" if label else row
                    run = write(name, f"s{scene}", seed, psnr=psnr, capture={"views": settings.get("views", 64)})
                    config = {"scene": {"name": f"s{scene}"}} | ({"capture": settings} if settings else {})
                    (run / "config.json").write_text(json.dumps({"config": config}))
    return tmp_path / "runs"


def found(runs: Path, table: Table, **options: str) -> dict[str, Map]:
    return {one.metric.key: one for one in maps(collect(find_run_folders(runs)).runs, table, **options)}


def test_gains_stand_by_photographs_and_by_what_else_is_left_out(runs: Path) -> None:
    """The mean over scenes of the means over seeds; decided where every scene says the same by far."""
    aligned = found(runs, Table())["aligned_albedo.psnr"]
    assert aligned.columns == ("HDR, mesh given", "LDR")
    texts = {name: [cell and (cell.text, cell.side, cell.worse) for cell in cells] for name, cells in aligned.lines}
    assert texts == {
        "64 photographs": [("+0.05", "undecided", False), None],
        "2 photographs": [("+3.05", "gains", False), ("-1.05", "costs", True)],
    }
    cell = aligned.lines[1][1][0]
    assert cell is not None
    assert (cell.row, cell.reference, cell.strength, cell.scenes) == ("kernel, 2 views", "none, 2 views", 100, ("s0", "s1"))
    low, high = (float(number) for number in cell.between.split(" to "))
    assert 2.9 <= low <= 3.05 <= high <= 3.2  # no interval of a bootstrap leaves what was measured
    assert "2 scenes, 4 pairs of runs" in cell.tip
    assert "kernel, 2 views: +3.05 dB over none, 2 views, which has 20.00" in cell.tip


def test_a_tables_own_captures_are_those_of_the_map(runs: Path) -> None:
    """The same from the names of rows alone, as of runs that only a runs.csv knows."""
    for path in runs.rglob("config.json"):
        path.unlink()
    table = Table(rows=[Row("none", []), Row("kernel", [])], reference="none", captures=[*CAPTURES.values()], photographs=100)
    assert found(runs, Table()) == {}
    recorded = collect(find_run_folders(runs)).runs
    for known, most in ((recorded, 64), ([replace(run, photographs=None) for run in recorded], 100)):
        lines = next(dict(one.lines) for one in maps(known, table) if one.metric.key == "relighting.psnr")
        assert [cell and cell.text for cell in lines["2 photographs"]] == ["+3.05", "-1.05"]
        assert list(lines) == [f"{most} photographs", "2 photographs"]


def test_a_capture_that_has_a_name_is_known_by_it(tmp_path: Path, write_run_below: Callable[..., Path]) -> None:
    for row, psnr in (("none", 20.0), ("kernel", 21.0)):
        for label, more in (("", {}), (", phone", {"given": {"capture.name": "phone"}})):
            run = write_run_below(tmp_path, row + label, "s0", psnr=psnr, capture={"views": 64})
            settings = identity(compose(["scene=tiny", *(["capture=phone"] if label else [])], here=False)).get("capture", {})
            (run / "config.json").write_text(json.dumps({"config": {"capture": settings}, **more}))
    lines = dict(found(tmp_path / "runs", Table())["aligned_albedo.psnr"].lines)
    assert [cell and (cell.row, cell.text) for cell in lines["64 photographs"]] == [("kernel", "+1.00"), ("kernel, phone", "+1.00")]


def test_runs_of_one_capture_have_no_map(write_run: Callable[..., Path]) -> None:
    folders = [write_run(row, "hat", 0) for row in ("none", "kernel")]
    for folder in folders:
        (folder / "config.json").write_text(json.dumps({"config": {"scene": {"name": "hat"}}}))
    assert maps(collect(folders).runs, Table()) == []


def test_the_map_is_read_and_clicked_in_a_browser(runs: Path, tmp_path: Path, open_page: Callable[[Path], Any]) -> None:
    assert main([str(runs), "--out", str(tmp_path / "out"), "--reference", "none"]) == 0
    page = open_page(tmp_path / "out" / "page")
    shown = page.locator("#worth .worth:not([data-away])")
    assert shown.count() == 1
    assert [text.split("\n")[0] for text in shown.locator(".gain").all_inner_texts()] == ["+0.05", "+3.05", "-1.05"]
    hatched = [cell.evaluate("cell => getComputedStyle(cell).backgroundImage") != "none" for cell in shown.locator(".gain").all()]
    assert hatched == [True, False, False]
    page.locator("#worth-metrics").get_by_role("button", name="Roughness MSE").click()
    assert shown.get_attribute("data-key") == "roughness.mse"
    page.locator("#worth-metrics").get_by_role("button", name="Relighting PSNR").click()
    shown.locator(".gain").nth(1).hover()
    assert "over none, 2 views" in page.locator("#tip").inner_text()
    shown.locator(".gain").nth(1).click()  # without pictures: the numbers
    assert page.locator("#evidence h2").inner_text() == "kernel, 2 views"
    assert page.locator("#evidence .figure").inner_text().startswith("23.05")
