"""The README's table against docs/results/table.csv. Its failure prints the rows as they should stand there."""

from __future__ import annotations

import csv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = {"albedo_psnr": 1, "aligned_albedo_psnr": 1, "view_synthesis_psnr": 1, "relighting_psnr": 1, "roughness_mse": 4}


def cell(value: str, half_width: str, decimals: int) -> str:
    """A mean and its interval: with one more decimal where it would be shown as zero, left out where it would be even so."""
    if not value:
        return "–"
    shown = f"{float(value):.{decimals}f}"
    half = float(half_width or 0)
    if round(half, decimals + 1):
        shown += f" ± {half:.{decimals if round(half, decimals) else decimals + 1}f}"
    return shown.replace("0.", ".") if decimals == 4 else shown


def line(row: dict[str, str]) -> str:
    name = row["row"] + (" †" if row["sees_truth"] == "True" else "")
    cells = [cell(row[column], row[f"{column}_half_width"], decimals) for column, decimals in COLUMNS.items()]
    return "| " + " | ".join([name, *cells]) + " |"


def test_the_readme_shows_the_published_table() -> None:
    with (ROOT / "docs" / "results" / "table.csv").open(encoding="utf-8") as file:
        expected = "\n".join(line(row) for row in csv.DictReader(file) if row["scene"] == "mean over scenes")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert expected
    assert expected in readme, f"README.md: expected the rows\n\n{expected}\n"
