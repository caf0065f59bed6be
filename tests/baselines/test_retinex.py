"""Retinex on pictures that keep its promise, on which it must be right, and as a prior."""

import numpy as np
import torch

from ia_bench.priors.contract import Observations
from ia_bench_baselines.retinex.prior import RetinexPrior

SIDE = 24


def observed(albedo: np.ndarray, shading: np.ndarray, mask: np.ndarray) -> Observations:
    image = albedo * shading[..., None] * mask[..., None]
    return Observations(torch.from_numpy(image[None]).float(), torch.from_numpy(mask[None]).float())


def patches_under_slow_light() -> tuple[np.ndarray, np.ndarray]:
    """Four flat paints side by side, two of one chromaticity, under light that rises by a factor of e from left to right."""
    albedo = np.zeros((SIDE, SIDE, 3))
    half = SIDE // 2
    albedo[:half, :half], albedo[:half, half:] = (0.2, 0.2, 0.2), (0.7, 0.7, 0.7)
    albedo[half:, :half], albedo[half:, half:] = (0.6, 0.2, 0.1), (0.1, 0.3, 0.5)
    shading = np.exp(np.linspace(0, 1, SIDE))[None].repeat(SIDE, 0)
    return albedo, shading


def test_flat_paints_under_a_slow_light_come_out_flat_and_in_proportion():
    """The light changes by .04 a pixel, the paints by .9 and more: every change is one or the other, up to .04 where both are."""
    albedo, shading = patches_under_slow_light()
    found = RetinexPrior(mean_albedo=albedo.mean()).sample(observed(albedo, shading, np.ones((SIDE, SIDE))), seed=0)
    result = found.values["albedo"][0].numpy()
    np.testing.assert_allclose(result, albedo, rtol=0.06)
    taken_as_it_is = albedo * shading[..., None]
    assert np.abs(taken_as_it_is * (albedo.mean() / taken_as_it_is.mean()) / albedo - 1).max() > 0.3


def test_pixels_outside_the_mask_are_black_and_change_nothing():
    albedo, shading = patches_under_slow_light()
    mask = np.zeros((SIDE, SIDE))
    mask[3:20, 4:22] = 1
    prior = RetinexPrior()
    inside = prior.sample(observed(albedo, shading, mask), seed=0).values["albedo"][0].numpy()
    assert (inside[mask == 0] == 0).all()
    strange = np.where(mask[..., None] > 0, albedo, 5.0)
    again = prior.sample(observed(strange, shading, mask), seed=1).values["albedo"][0].numpy()
    np.testing.assert_array_equal(inside, again)
