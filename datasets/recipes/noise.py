"""Monte Carlo noise of the rendered images, measured with two seeds."""

import numpy as np
from materials import encode_srgb
from numpy.typing import NDArray
from recipe import Recipe
from scene_folder import views
from split_render import SplitRenderer

CAMERAS = (0.25, 0.75)
"""Novel cameras that are measured, as fractions of the split."""

NOISE_DEFINITION = (
    "two novel views per light with the samples of novel views, two seeds; all: RMS difference / sqrt(2) / mean, over "
    "foreground pixels; 99_percent: without the worst pixel in a hundred; srgb_db: PSNR of one image against a noiseless "
    "one, sRGB values in [0, 1], foreground pixels"
)


def relative_noise(first: NDArray[np.floating], second: NDArray[np.floating], kept: float = 1.0) -> float:
    """Standard deviation of one RGBA image (H, W, 4) relative to its mean, from two renders with other seeds.

    RMS over foreground pixels (coverage above one half) and channels of the difference, divided by sqrt(2), since both
    images are noisy, and by the mean of the foreground. `kept` is the share of pixels, those with the smallest
    differences, that count: 0.99 leaves out the heart of highlights, which are many times brighter than the mean.
    """
    a, b = foreground(first, second)
    squares = np.sort(np.mean((a - b) ** 2, axis=1))[: max(1, round(kept * len(a)))]
    return float(np.sqrt(np.mean(squares) / 2) / ((a.mean() + b.mean()) / 2))


def srgb_noise(first: NDArray[np.floating], second: NDArray[np.floating]) -> float:
    """Variance of one RGBA image (H, W, 4) in sRGB values clipped to [0, 1], from two renders with other seeds."""
    a, b = (encode_srgb(np.clip(values, 0, 1)) for values in foreground(first, second))
    return float(np.mean((a - b) ** 2) / 2)


def foreground(*images: NDArray[np.floating]) -> list[NDArray[np.float64]]:
    """Colours (N, 3) of the pixels that every RGBA image (H, W, 4) covers by more than one half."""
    inside = np.all([image[..., 3] > 0.5 for image in images], axis=0)
    return [image[inside][:, :3].astype(np.float64) for image in images]


def measure(recipe: Recipe, renderer: SplitRenderer) -> dict[str, dict[str, float]]:
    """Noise of some novel views for every light, as NOISE_DEFINITION says."""
    result = {}
    chosen = {int(fraction * recipe.views["novel"]) for fraction in CAMERAS}
    for light in recipe.lights:
        squares, variances = [], []
        for view in views(recipe):
            if view.split == "novel" and view.light == light and view.index in chosen:
                a, b = (renderer.render(light, view.pose, recipe.samples["novel"], seed=seed).rgba for seed in (1, 2))
                squares.append([relative_noise(a, b, kept) ** 2 for kept in (1.0, 0.99)])
                variances.append(srgb_noise(a, b))
        everything, most = np.sqrt(np.mean(squares, axis=0))
        decibels = -10 * np.log10(np.mean(variances))
        result[light] = {
            "all": round(float(everything), 5),
            "99_percent": round(float(most), 5),
            "srgb_db": round(float(decibels), 2),
        }
    return result
