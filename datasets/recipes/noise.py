"""Monte Carlo noise of the rendered images, measured with two seeds."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from recipe import Recipe
from renderer import Renderer
from scene_folder import views

CAMERAS = (0.2, 0.5, 0.8)
"""Novel cameras that are measured, as fractions of the split."""


def relative_noise(first: NDArray[np.floating], second: NDArray[np.floating], kept: float = 1.0) -> float:
    """Standard deviation of one RGBA image (H, W, 4) relative to its mean, from two renders with other seeds.

    RMS over foreground pixels (coverage above one half) and channels of the difference, divided by sqrt(2), since both
    images are noisy, and by the mean of the foreground. `kept` is the share of pixels, those with the smallest
    differences, that count: 0.99 leaves out the heart of highlights, which are many times brighter than the mean.
    """
    foreground = (first[..., 3] > 0.5) & (second[..., 3] > 0.5)
    a, b = (image[foreground][:, :3].astype(np.float64) for image in (first, second))
    squares = np.sort(np.mean((a - b) ** 2, axis=1))[: max(1, round(kept * len(a)))]
    return float(np.sqrt(np.mean(squares) / 2) / ((a.mean() + b.mean()) / 2))


def measure(recipe: Recipe, out: Path, renderer: Renderer) -> dict[str, dict[str, float]]:
    """Root mean square of the relative noise over some novel cameras, for every light: of all pixels, of 99 %."""
    result = {}
    chosen = {int(fraction * recipe.views["novel"]) for fraction in CAMERAS}
    for light in recipe.lights:
        renderer.set_light(out / "lights" / f"{light}.exr")
        squares = []
        for view in views(recipe):
            if view.split == "novel" and view.light == light and view.index in chosen:
                first, second = (renderer.render(view.pose, recipe.samples[light], seed=seed).rgba for seed in (1, 2))
                squares.append([relative_noise(first, second, kept) ** 2 for kept in (1.0, 0.99)])
        everything, most = np.sqrt(np.mean(squares, axis=0))
        result[light] = {"all": round(float(everything), 5), "99_percent": round(float(most), 5)}
    return result
