"""Noise, patterns, materials and the filter of shading: ranges, purity, statistics."""

import numpy as np
import pytest
import torch

from ia_bench_training.noise import PERIOD, fractal, noise
from ia_bench_training.palettes import MAX_ALBEDO, MIN_ALBEDO, palette
from ia_bench_training.patterns import PATTERNS
from ia_bench_training.smooth import smooth_shading
from ia_bench_training.textures import draw_materials

POINTS = torch.rand(3000, 3, generator=torch.Generator().manual_seed(5)) * 2 - 1
AXIS = torch.arange(3000) % 3


def test_noise_is_continuous_periodic_and_its_sums_keep_their_variance():
    step = 1e-3
    moved = noise(POINTS * 9 + torch.tensor([step, 0, 0]))
    assert (moved - noise(POINTS * 9)).abs().max() < 4 * step  # slope of the fade is at most 1.5, of values 2
    assert (noise(POINTS * 9 + PERIOD) - noise(POINTS * 9)).abs().max() < 1e-3
    for octaves in (1, 3, 6):
        assert fractal(POINTS * 12, octaves).std() == pytest.approx(1.25, abs=0.15)


@pytest.mark.parametrize("family", [family for family, _ in PATTERNS], ids=lambda f: f.__name__)
def test_patterns_stay_in_range_and_are_pure(family):
    varied = 0
    for seed in range(6):
        pattern = family(np.random.default_rng(seed))
        value = pattern(POINTS, AXIS)
        assert value.shape == (3000,)
        assert value.min() >= 0
        assert value.max() <= 1
        torch.testing.assert_close(pattern(POINTS[100:200], AXIS[100:200]), value[100:200], atol=1e-4, rtol=0)
        varied += bool(value.std() > 0.03)
    assert varied >= 5


def test_materials_stay_in_their_declared_ranges():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        colours = palette(rng, 5)
        assert colours.min() >= MIN_ALBEDO
        assert colours.max() <= MAX_ALBEDO
        for material in draw_materials(rng, 3):
            albedo, roughness = material(POINTS[:200], AXIS[:200])
            assert MIN_ALBEDO - 1e-6 <= float(albedo.min()) <= float(albedo.max()) <= MAX_ALBEDO + 1e-6
            assert 0.05 - 1e-6 <= float(roughness.min()) <= float(roughness.max()) <= 1


def test_an_overlaid_material_shows_both():
    """Where no mask lets the upper one through it is the lower one, it differs somewhere, and it stays what it is."""
    changed = 0.0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lower, upper = draw_materials(rng, 2)
        both = lower.overlaid(upper, rng)
        assert all(layer.mask is not None for layer in both.layers[len(lower.layers) :])
        albedo, roughness = both(POINTS, AXIS)
        torch.testing.assert_close(roughness, lower(POINTS, AXIS)[1])
        masks = torch.stack([layer.mask(POINTS * both.scale, AXIS) for layer in both.layers[len(lower.layers) :]])
        below = (masks == 0).all(0)
        torch.testing.assert_close(albedo[below], lower(POINTS, AXIS)[0][below])
        torch.testing.assert_close(albedo, both(POINTS, AXIS)[0])
        changed += float((albedo - lower(POINTS, AXIS)[0]).abs().amax(1).gt(0.02).float().mean()) / 12
    assert 0.1 < changed < 0.95


def test_smoothing_takes_noise_out_and_leaves_texture_and_shadow_edges():
    generator = torch.Generator().manual_seed(2)
    size = 41
    shadow = torch.where(torch.arange(size) < 20, 1.0, 0.2)[None, None, :, None].expand(1, size, size, 3)
    albedo = 0.1 + 0.8 * torch.rand(1, size, size, 3, generator=generator)
    noisy = shadow * (1 + 0.08 * torch.randn(1, size, size, 1, generator=generator))
    normal = torch.tensor([0.0, 0, 1]).expand(1, size, size, 3)
    ones = torch.ones(1, size, size, 1)
    diffuse, sky = smooth_shading(albedo * noisy, albedo, normal, 0.5 * ones, ones)
    error = diffuse / albedo / shadow - 1
    assert error.std() < 0.08 / 2.5
    assert abs(float(error.mean())) < 0.01
    assert error[:, :, 18:22].abs().mean() < 0.06
    torch.testing.assert_close(sky, 0.5 * ones)
