"""How much an albedo varies, by hand: half of the pixels twice as bright vary by half a stop, and so do channels."""

import numpy as np
import pytest

from benchmarks.one_material import variation


def test_variation_is_in_stops_and_knows_no_scale() -> None:
    even = np.full((100, 3), 0.3)
    assert variation(even) == pytest.approx((0.0, 0.0), abs=1e-12)
    brighter = even.copy()
    brighter[::2] *= 2
    assert variation(brighter) == pytest.approx((0.5, 0.0), abs=0.01)
    assert variation(7 * brighter) == pytest.approx(variation(brighter))
    redder = even.copy()
    redder[::2, 0] *= 2
    grey, chroma = variation(redder)
    assert chroma == pytest.approx(0.5 / np.sqrt(2), abs=0.01)  # of two chromaticities one varies
    assert 0 < grey < 0.25
