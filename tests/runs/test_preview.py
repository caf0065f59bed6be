"""The picture of a run's folder: what is in it, in which order, and how large it is."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from ia_bench.runs.pictures.drawing import Pictures
from ia_bench.runs.pictures.preview import GAP, LINE, WIDTH, labelled, preview

SQUARE, LIGHT = np.full((40, 40, 3), 0.5), np.full((16, 32, 3), 0.5)


@pytest.mark.parametrize(
    ("true", "found", "rows", "columns"),
    [
        (("view", "albedo", "roughness", "relit", "light"), ("view", "albedo", "aligned", "roughness", "relit", "light"), 2, 5),
        (("photograph",), ("view", "albedo", "roughness", "light"), 1, 5),
        (("photograph",), ("albedo",), 1, 3),  # no light: the place of the render stays empty
    ],
)
def test_truth_is_above_what_was_recovered(true: tuple[str, ...], found: tuple[str, ...], rows: int, columns: int) -> None:
    sides = [Pictures({name: [LIGHT if name == "light" else SQUARE] for name in names}) for names in (true, found)]
    side = (WIDTH - GAP) // columns - GAP
    assert preview("hat", *sides).size == (columns * (side + GAP) + GAP, LINE + GAP + rows * (LINE + side + GAP))


def test_pictures_stand_below_their_names() -> None:
    red, clear = Image.new("RGB", (4, 4), "red"), Image.new("RGBA", (4, 4))
    shown = np.asarray(labelled([[("a", red), None], [("b", clear), ("c", red)]], width=216))
    assert (shown[LINE : LINE + 96, GAP : GAP + 96] == (255, 0, 0)).all()
    assert (shown[LINE:, 2 * GAP + 96 :][:96] == 255).all()
    assert (shown[-GAP - 96 : -GAP, GAP : GAP + 96] == 255).all()
