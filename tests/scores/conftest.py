"""Small random scenes to score: odd, non-square images with soft-edged discs as coverage."""

import numpy as np
import pytest
import torch

from ia_bench.scenes.images import Images
from ia_bench.scores import metrics as perceptual
from ia_bench.scores.comparison import Predictions

HEIGHT, WIDTH = 37, 43  # larger than the SSIM window and than the smallest LPIPS image, and not square


def disc(height: int = HEIGHT, width: int = WIDTH, *, radius: float = 12.0) -> np.ndarray:
    """Coverage (H, W) of a disc in the middle with an edge one pixel wide."""
    y, x = np.mgrid[:height, :width]
    return np.clip(radius + 0.5 - np.hypot(y - height / 2, x - width / 2), 0.0, 1.0)


def random_images(seed: int, views: int = 3, channels: int | None = 3, scale: float = 0.8) -> Images:
    """Premultiplied random images in [0.05, 0.05 + scale], their discs of different size."""
    random = np.random.default_rng(seed)
    coverage = tuple(disc(radius=10.0 + index) for index in range(views))
    shape = (HEIGHT, WIDTH) if channels is None else (HEIGHT, WIDTH, channels)
    weights = [c if channels is None else c[..., None] for c in coverage]
    return Images(tuple(w * (0.05 + scale * random.random(shape)) for w in weights), coverage)


@pytest.fixture
def mean_square_as_lpips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean square over channels in place of the network: quick, zero for identical images."""

    def distances(predicted: np.ndarray, true: np.ndarray, settings: object) -> list[torch.Tensor]:
        return [torch.from_numpy(((predicted - true) ** 2).mean(-1))[None, None]]

    monkeypatch.setattr(perceptual, "layer_distances", distances)


@pytest.fixture
def truth() -> Predictions:
    """Ground truth of three views and two novel lights."""
    return Predictions(
        albedo=random_images(0),
        roughness=random_images(1, channels=None),
        view_synthesis=random_images(2),
        relighting={"night": random_images(3), "studio": random_images(4)},
    )


@pytest.fixture
def guess() -> Predictions:
    """Something else with the same masks. Its albedo stays below 0.45, so that tests may scale it without clipping."""
    return Predictions(
        albedo=random_images(10, scale=0.4),
        roughness=random_images(11, channels=None),
        view_synthesis=random_images(12),
        relighting={"night": random_images(13), "studio": random_images(14)},
    )
