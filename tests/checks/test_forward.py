"""Ground truth through our renderer against Cycles: the gap, and that its parts are where they are said to be."""

from pathlib import Path

import pytest

from ia_bench.checks.forward import check_scene, coat_reflectance

SCENES = Path(__file__).parents[2] / "datasets" / "scenes"


def test_coat_reflects_a_little_head_on_and_much_at_grazing() -> None:
    share = coat_reflectance(16, samples=512)
    assert (share >= 0).all()
    assert (share <= 1).all()
    smooth = share[2]  # roughness 0.16
    assert float(smooth[-1]) == pytest.approx(0.04, abs=0.01)  # normal incidence: F0
    assert float(smooth[0]) > 0.3  # grazing


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hat", "ship", "console", "figurine"])
def test_direct_light_is_closer_to_ours_than_full_transport(name: str) -> None:
    check = check_scene(SCENES / name, samples=64)
    assert check.psnr["direct"] > check.psnr["full"] - 0.5
    assert check.psnr["direct"] > 24
    assert 0.9 < check.ratio < 1.15
