"""preview.png of a run's folder: what was given and what was recovered of it, in one picture that explains itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ia_bench.runs.pictures.drawing import Pictures

PREVIEW = "preview.png"
WIDTH = 1200  # pixels of the whole picture, at most
GAP, LINE, FONT = 8, 22, 14  # pixels between pictures, of a line of text, and of its letters
COLUMNS = {
    "view": ("render of what was recovered", "photograph"),
    "aligned": ("recovered albedo, aligned", "true albedo"),
    "albedo": ("recovered albedo", "true albedo"),
    "roughness": ("recovered roughness", "true roughness"),
    "relit": ("render, new light", "photograph, new light"),
    "light": ("recovered light", "true light"),
}
"""Sheet of what was recovered -> what it and the truth beside it are called."""

Cell: TypeAlias = tuple[str, Image.Image] | None
Row: TypeAlias = Sequence[Cell]
"""Pictures with what is written above each; None leaves a place empty."""


def preview(title: str, true: Pictures, found: Pictures, places: Mapping[str, int]) -> Image.Image:
    """What was recovered (``found``) below the truth and the photographs; in one row where only photographs are known.

    ``places``: which picture of a sheet is shown, the first where it says none (:meth:`SceneRenderer.of_one_view`).
    """
    above: list[Cell] = []
    below: list[Cell] = []
    for name, labels in COLUMNS.items():
        if name == "albedo" and "aligned" in found.sheets:
            continue
        sheets = [pictures.sheets.get("albedo" if name == "aligned" and pictures is true else name) for pictures in (found, true)]
        for row, label, shown in zip((below, above), labels, sheets, strict=True):
            row.append((label, Image.fromarray(np.round(255 * shown[places.get(name, 0)]).astype(np.uint8))) if shown else None)
        if below[-1] is above[-1] is None:
            del below[-1], above[-1]
    return labelled([above, below] if any(above[1:]) else [[above[0], *below]], title, width=WIDTH)


def labelled(rows: Sequence[Row], title: str = "", *, width: int) -> Image.Image:
    """Rows of pictures over white with their names above, all of one width and ``width`` together."""
    columns = max(map(len, rows))
    side = (width - GAP) // columns - GAP
    high = max(round(cell[1].height * side / cell[1].width) for row in rows for cell in row if cell is not None)
    top = LINE + GAP if title else 0
    whole = Image.new("RGB", (columns * (side + GAP) + GAP, top + len(rows) * (LINE + high + GAP)), "white")
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(FONT)
    draw.text((GAP, GAP), title, "black", font)
    for number, row in enumerate(rows):
        for column, cell in enumerate(row):
            if cell is not None:
                left, upper = GAP + column * (side + GAP), top + number * (LINE + high + GAP)
                draw.text((left, upper + 2), cell[0], "black", font)
                kind = Image.Resampling.NEAREST if 3 * cell[1].width < side else Image.Resampling.BICUBIC
                shown = cell[1].resize((side, round(cell[1].height * side / cell[1].width)), kind)
                whole.paste(shown, (left, upper + LINE), shown if shown.mode == "RGBA" else None)
    return whole
