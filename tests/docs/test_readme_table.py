"""The README's table against docs/results/table.csv. Its failure prints the row as it should stand there."""

from __future__ import annotations

import csv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = ("aligned_albedo_psnr", "relighting_psnr", "roughness_mse")
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
        assert cells[2:] == [cell(rows[name], column) for column in COLUMNS], f"README.md, row {name}"
