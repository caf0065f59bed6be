"""Ground truth through our renderer against Cycles: the gap, and that its parts are where they are said to be."""

from pathlib import Path

import pytest

from benchmarks.forward_check import check_scene

SCENES = Path(__file__).parents[2] / "datasets" / "scenes"


@pytest.mark.verify
@pytest.mark.slow
@pytest.mark.parametrize("name", ["hat", "ship", "console", "figurine"])
def test_what_the_renderer_models_brings_it_nearer_to_cycles(name: str) -> None:
    """64 samples a pixel, whose noise is in the figures; with 256 they are up to 1 dB higher."""
    check = check_scene(SCENES / name, samples=64)
    assert check.psnr["full, 16 points a pixel"] > 29.0
    assert check.psnr["full"] > check.psnr["full, without indirect light"] + 0.5
    assert check.psnr["full"] > check.psnr["full, coat added"] + 0.3
    assert 0.98 < check.ratio < 1.02
