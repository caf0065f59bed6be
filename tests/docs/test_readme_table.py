"""The README's table against docs/results/table.csv and seconds.csv. Its failure prints the row as it should stand there."""

from __future__ import annotations

import csv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = ("aligned_albedo_psnr", "relighting_psnr", "roughness_mse")
EQUAL = "equal_seconds"
SHOWN = ["constant", "nvdiffrecmc, shared mesh", "diffusion, targets", "none", "diffusion, kernel", "combined", "oracle"]


def cell(row: dict[str, str], column: str) -> str:
    """A mean and its interval: with one more decimal where it would be shown as zero, left out where it would be even so.

    Of a mean square, three decimals and no interval.
    """
    if column.endswith("_mse"):
        return f"{float(row[column]):.3f}".lstrip("0")
    half = float(row[f"{column}_half_width"] or 0)
    shown = f"{float(row[column]):.1f}"
    return shown + (f" ± {half:.{1 if round(half, 1) else 2}f}" if round(half, 2) else "")


def at_equal_seconds(row: str) -> str:
    """What a row gains in aligned albedo over no prior at equal seconds, by seconds.csv; a dash where nobody compares them."""
    with (ROOT / "docs" / "results" / "seconds.csv").open(encoding="utf-8") as file:
        found = [one for one in csv.DictReader(file) if (one["row"], one["metric"]) == (row, "aligned_albedo.psnr")]
    if not found or row == found[0]["reference"]:
        return "–"
    return f"{float(found[0][EQUAL]):+.1f} ± {float(found[0][f'{EQUAL}_half_width_over_seeds']):.1f}"


def test_the_readme_shows_the_published_table() -> None:
    with (ROOT / "docs" / "results" / "table.csv").open(encoding="utf-8") as file:
        rows = {row["row"]: row for row in csv.DictReader(file) if row["scene"] == "mean over scenes"}
    lines = [
        [part.strip() for part in line.strip("|\n").split("|")]
        for line in (ROOT / "README.md").open(encoding="utf-8")
        if line[0] == "|"
    ]
    shown = {cells[0].removesuffix(" †"): cells for cells in lines if cells[0].removesuffix(" †") in rows}
    assert sorted(shown) == sorted(SHOWN)
    for name, cells in shown.items():
        assert cells[0].endswith("†") == (rows[name]["sees_truth"] == "True"), name
        aligned, *others = (cell(rows[name], column) for column in COLUMNS)
        assert cells[2:] == [aligned, at_equal_seconds(name), *others], f"README.md, row {name}"
