"""Pictures of runs: how they are exposed, cut out, and laid out below their names."""

import numpy as np
import pytest
from PIL import Image

from ia_bench.runs.pictures.drawing import CUT_MARGIN, GREY, cut_out, exposure, extent, on_grey
from ia_bench.runs.pictures.preview import GAP, LINE, labelled


def test_exposure_shows_all_but_the_brightest_hundredth_of_all_foregrounds() -> None:
    images, masks = np.full((1, 20, 20, 3), 0.5, np.float32), np.ones((1, 20, 20), np.float32)
    images[0, 0, 0], images[0, 10:], masks[0, 10:] = 1e6, 7.0, 0.0
    assert exposure(images, masks) == pytest.approx(2)
    # 199 pixels of 4 and two of 10, in two pictures: the brightest hundredth is left out
    images = [np.full((10, 10, 3), 4.0), np.full((1, 101, 3), 4.0)]
    images[1][0, :2] = 10.0
    assert exposure(images, [np.ones(image.shape[:2]) for image in images]) == pytest.approx(1 / 4)


@pytest.mark.parametrize("corner", [(0, 0), (3, 5), (12, 8)])
def test_cut_out_is_the_square_around_the_object_also_at_an_edge(corner: tuple[int, int]) -> None:
    mask = np.zeros((16, 20), np.float32)
    mask[corner[0] : corner[0] + 4, corner[1] : corner[1] + 6] = 1
    side = extent(mask)
    assert side == 6 + 2 * CUT_MARGIN
    found = cut_out(on_grey(np.ones((16, 20, 3)), mask), mask, side)
    expected = np.full((side, side, 3), GREY)
    expected[CUT_MARGIN + 1 : -CUT_MARGIN - 1, CUT_MARGIN:-CUT_MARGIN] = 1
    np.testing.assert_array_equal(found, expected)
    assert found.base is None, "a part of the whole picture keeps all of it in memory"


def test_pictures_stand_below_their_names() -> None:
    red, clear = Image.new("RGB", (4, 4), "red"), Image.new("RGBA", (4, 4))
    shown = np.asarray(labelled([[("a", red), None], [("b", clear), ("c", red)]], width=216))
    assert (shown[LINE : LINE + 96, GAP : GAP + 96] == (255, 0, 0)).all()
    assert (shown[LINE:, 2 * GAP + 96 :][:96] == 255).all()
    assert (shown[-GAP - 96 : -GAP, GAP : GAP + 96] == 255).all()
