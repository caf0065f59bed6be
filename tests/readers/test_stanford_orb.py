"""Truth of Stanford-ORB at the size of shrunken photographs: what is constant on the object is that constant times coverage."""

from pathlib import Path

import numpy as np
import pytest
from layouts import STEEPEST, STEP, scene_to_write

from ia_bench.readers.stanford_orb import StanfordOrbReader
from ia_bench.readers.writers.frames import write_stanford_orb
from ia_bench.readers.writers.parts import save_png
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene

CAPTURE, NAME = "object_scene001", "0000"
ALBEDO = (0.5, 0.25, 0.125)
DEPTH = 3.0


@pytest.fixture
def folder(tmp_path: Path, tiny: Scene) -> Path:
    """The scene `tiny`; its first held-out view shows a square without one corner, and with half of the pixel at another."""
    write_stanford_orb(tmp_path, scene_to_write(tiny))
    mask = np.zeros((32, 32))
    mask[8:24, 8:24], mask[8, 8], mask[23, 23] = 1, 0, 0.5
    save_png(tmp_path / "blender_HDR" / CAPTURE / "test_mask" / f"{NAME}.png", mask)
    return tmp_path


def save(folder: Path, kind: str, values: np.ndarray) -> None:
    np.save(folder / "ground_truth" / CAPTURE / kind / f"{NAME}.npy", values.astype(np.float32))


@pytest.mark.parametrize(("side", "suffix"), [(32, ".png"), (32, ".npy"), (16, ".npy")])  # of the photograph, of the shrunken one
def test_truth_is_multiplied_by_coverage_once(folder: Path, side: int, suffix: str) -> None:
    """Files hold the constant in every pixel that shows some object, black and a depth of -1 in all others."""
    one, two = (StanfordOrbReader(folder, capture=CAPTURE, shrink=shrink).read(truth=False).test[0] for shrink in (1, 2))
    there = ((one if side == 32 else two).mask > 0)[..., None]
    picture = folder / "ground_truth" / CAPTURE / "pseudo_gt_albedo" / f"{NAME}.png"
    if suffix == ".png":
        save_png(picture, linear_to_srgb(there * ALBEDO))
    else:
        picture.unlink()
        save(folder, "pseudo_gt_albedo", there * ALBEDO)
    save(folder, "surface_normal", there * (0.0, 0.0, 1.0))
    save(folder, "z_depth", np.where(there, DEPTH, -1.0))
    view = StanfordOrbReader(folder, capture=CAPTURE, shrink=2).read(truth=True).test[0]
    expected = np.zeros((16, 16))
    expected[4:12, 4:12], expected[4, 4], expected[11, 11] = 1, 0.75, 0.875
    np.testing.assert_allclose(view.mask, expected, atol=STEP)
    coverage = view.mask[..., None]
    np.testing.assert_allclose(view.albedo, coverage * ALBEDO, atol=STEEPEST * STEP if suffix == ".png" else 1e-6)
    np.testing.assert_allclose(view.normal, coverage * view.camera.to_world[:3, 2], atol=1e-6)
    np.testing.assert_allclose(view.depth, view.mask * DEPTH, atol=1e-5)
