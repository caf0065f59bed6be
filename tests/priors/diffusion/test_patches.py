"""Large images: exact where the denoiser returns its condition, the same whatever is sampled beside, and without seams.

The prior of the seam tests is a stationary Gaussian field with correlation length ELL, on each patch with its exact covariance:
a sample of one patch has the same gradient energy everywhere, so whatever differs comes from putting patches together.
"""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.guidance import Guidance, GuidanceReport
from ia_bench.priors.diffusion.operators import GaussianBlur
from ia_bench.priors.diffusion.patches import PatchSettings, hann_window, patch_origins, sample_large
from ia_bench.priors.diffusion.sampler import Denoise, SamplerSettings, sample
from ia_bench.priors.diffusion.schedule import NoiseSchedule

SCHEDULE = NoiseSchedule(torch.cos(torch.linspace(0.02, 1.56, 200, dtype=torch.float64)).square())
UNGUIDED = PatchSettings(strength=0.0)
NATIVE, ELL, VARIANCE = 32, 1.5, 0.05


def give_back(condition: Tensor) -> Denoise:
    return lambda noisy, t: condition


def mix(condition: Tensor) -> Denoise:
    """Value by value, so that no batch can change a bit: depends on condition, noise and timestep."""
    return lambda noisy, t: torch.tanh(condition[:, :1] + 0.8 * noisy - 0.001 * t)


def field_prior(size: int, ell: float = ELL):
    """The exact denoiser of the stationary field on ``size`` x ``size``, any channels, whatever the condition."""
    index = torch.arange(size, dtype=torch.float64)
    values, vectors = torch.linalg.eigh(torch.exp(-((index[:, None] - index) / (2 * ell)).square()))
    spectrum, vectors = (VARIANCE * values[:, None] * values).clamp(min=0).float(), vectors.float()

    def make_denoise(condition: Tensor) -> Denoise:
        def denoise(noisy: Tensor, t: int) -> Tensor:
            level = float(SCHEDULE.alpha_bar[t])
            gain = spectrum * math.sqrt(level) / (spectrum * level + 1 - level)
            return vectors @ (gain * (vectors.T @ noisy @ vectors)) @ vectors.T

        return denoise

    return make_denoise


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1


@pytest.mark.parametrize(("height", "width"), [(32, 32), (33, 64), (37, 31), (90, 107), (100, 333)])
@pytest.mark.parametrize("overlap", [0.0, 0.25, 0.5, 0.9])
def test_patches_cover_everything_and_overlap(height: int, width: int, overlap: float):
    height, width = max(height, 32), max(width, 32)
    origins = list(patch_origins(height, width, 32, overlap))
    covered = torch.zeros(height, width, dtype=torch.bool)
    for top, left in origins:
        assert 0 <= top <= height - 32
        assert 0 <= left <= width - 32
        covered[top : top + 32, left : left + 32] = True
    assert bool(covered.all())
    for axis in (0, 1):
        starts = sorted({origin[axis] for origin in origins})
        assert all(0 < b - a <= 32 - math.floor(32 * overlap) for a, b in itertools.pairwise(starts))


def test_window_is_positive_and_adds_up_at_half_overlap():
    window = hann_window(NATIVE)
    assert float(window.min()) > 0
    constant = torch.full((16,), math.sin(3.5 * math.pi / 32) ** 2, dtype=torch.float64)
    torch.testing.assert_close(window[:16, 3] + window[16:, 3], constant)


@pytest.mark.parametrize("size", [(32, 32), (20, 31), (64, 64), (37, 31), (20, 90), (75, 101)])
def test_a_denoiser_that_returns_its_condition_gives_it_back_exactly(size: tuple[int, int]):
    condition = random(2, 3, *size)
    settings = SamplerSettings(3, eta=0.5)
    found = sample_large(
        give_back, SCHEDULE, condition, NATIVE, channels=3, seeds=[0, 1], settings=settings, patches=PatchSettings(0.3, 0.0)
    )
    assert torch.equal(found, condition)
    flat = condition[..., :1, :1].expand_as(condition)  # coarse and fine agree: guidance has nothing to change
    found = sample_large(give_back, SCHEDULE, flat, NATIVE, channels=3, seeds=[0, 1], settings=settings)
    torch.testing.assert_close(found, flat, rtol=0, atol=1e-5)


def test_at_native_size_it_is_the_plain_sampler():
    condition, settings = random(2, 1, NATIVE, NATIVE), SamplerSettings(5, eta=1.0)
    found = sample_large(mix, SCHEDULE, condition, NATIVE, channels=3, seeds=[3, 4], settings=settings)
    assert torch.equal(found, sample(mix(condition), SCHEDULE, (2, 3, NATIVE, NATIVE), [3, 4], settings))


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_an_image_depends_neither_on_its_neighbours_nor_on_the_batch(eta: float):
    condition = random(3, 1, 50, 71)
    common = {"channels": 2, "settings": SamplerSettings(4, eta)}
    unguided = {**common, "patches": PatchSettings(strength=0.0, batch=5)}  # guided: the blur is a product of matrices
    together = sample_large(mix, SCHEDULE, condition, NATIVE, seeds=[7, 0, 5], **unguided)
    alone = sample_large(mix, SCHEDULE, condition[2:], NATIVE, seeds=[5], **{**common, "patches": UNGUIDED})
    assert torch.equal(together[2:], alone)
    together = sample_large(mix, SCHEDULE, condition, NATIVE, seeds=[7, 0, 5], **common, patches=PatchSettings(batch=5))
    alone = sample_large(mix, SCHEDULE, condition[2:], NATIVE, seeds=[5], **common)
    torch.testing.assert_close(together[2:], alone, rtol=0, atol=1e-5)


def test_patches_without_foreground_are_skipped():
    condition, foreground = random(2, 1, 96, 96), torch.zeros(2, 1, 96, 96)
    foreground[0, 0, :20, :20] = 1
    calls = []

    def counting(batch: Tensor) -> Denoise:
        calls.append(len(batch))
        return mix(batch)

    common = {"channels": 1, "seeds": [0, 1], "settings": SamplerSettings(3), "patches": UNGUIDED}
    found = sample_large(counting, SCHEDULE, condition, NATIVE, foreground=foreground, **common)
    assert calls == [2, 4]  # coarse images, then the patches at (0, 16) x (0, 16)
    everything = sample_large(mix, SCHEDULE, condition, NATIVE, **common)
    assert torch.equal(found[0, :, :16, :16], everything[0, :, :16, :16])
    coarse = sample_large(mix, SCHEDULE, condition, NATIVE, foreground=torch.zeros_like(foreground), **common)
    assert torch.equal(found[1], coarse[1])
    assert torch.equal(found[0, :, 48:], coarse[0, :, 48:])


def gradient_energy(image: Tensor, borders: list[int], margin: int) -> tuple[float, float]:
    """Mean squared difference of neighbouring columns across ``borders``, and everywhere else, off the image's edge."""
    energy = (image[..., 1:] - image[..., :-1]).square().mean((0, 1, 2))
    at_border = torch.zeros(len(energy), dtype=torch.bool)
    at_border[[border - 1 for border in borders]] = True
    inside = torch.zeros_like(at_border)
    inside[margin:-margin] = True
    return float(energy[at_border & inside].mean()), float(energy[~at_border & inside].mean())


@pytest.mark.parametrize("strength", [0.0, 100.0])
@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_no_seams(strength: float, eta: float):
    """Within 5 %: the ratio scatters by 1.2 % (24 images x 3 channels x 90 rows, 16 lines), so four sigma; seeds are fixed."""
    count, height, width = 24, 90, 107
    patches, settings = PatchSettings(strength=strength), SamplerSettings(10, eta, clip=None)
    condition = torch.zeros(count, 1, height, width)
    found = sample_large(
        field_prior(NATIVE), SCHEDULE, condition, NATIVE, channels=3, seeds=range(count), settings=settings, patches=patches
    )
    origins = list(patch_origins(height, width, NATIVE, patches.overlap))
    border = other = 0.0
    for image, axis in ((found, 1), (found.mT, 0)):
        lines = sorted({line for origin in origins for line in (origin[axis], origin[axis] + NATIVE)})
        energies = gradient_energy(image, lines[1:-1], margin=4)
        border, other = border + energies[0], other + energies[1]
    assert abs(border / other - 1) < 0.05, f"gradient energy across patch borders / elsewhere = {border / other:.3f}"


def test_overlapping_patches_keep_their_detail():
    """Independent patches would keep about half of their variance where two overlap, a quarter where four do."""
    condition, settings = torch.zeros(12, 1, 80, 80), SamplerSettings(10, clip=None)
    single = sample(field_prior(NATIVE)(condition), SCHEDULE, (48, 3, NATIVE, NATIVE), range(48), settings).var()
    found = sample_large(
        field_prior(NATIVE), SCHEDULE, condition, NATIVE, channels=3, seeds=range(12), settings=settings, patches=UNGUIDED
    )
    assert float(found.var() / single) > 0.9


def test_patches_follow_the_coarse_sample():
    """With correlations as long as a patch, unguided patches drift from the coarse sample; guided ones follow it."""
    condition, settings = torch.zeros(4, 1, 96, 96), SamplerSettings(10, clip=None)
    coarse = sample(field_prior(NATIVE, 8.0)(condition), SCHEDULE, (4, 3, NATIVE, NATIVE), range(4), settings)
    errors = {}
    for strength in (0.0, 100.0):
        found = sample_large(
            field_prior(NATIVE, 8.0), SCHEDULE, condition, NATIVE,
            channels=3, seeds=range(4), settings=settings, patches=PatchSettings(strength=strength),
        )  # fmt: skip
        reduced = torch.nn.functional.avg_pool2d(GaussianBlur(1.5).apply(found), 3)
        errors[strength] = float((reduced - coarse).square().mean() / coarse.square().mean())
    assert errors[0.0] > 0.5
    assert errors[100.0] < 0.1


def test_guidance_reaches_coarse_and_patches():
    condition, target = random(2, 1, 50, 71), random(2, 1, 50, 71, seed=1)
    common = {"channels": 1, "seeds": [0, 1], "settings": SamplerSettings(4)}
    plain = sample_large(mix, SCHEDULE, condition, NATIVE, **common)
    nothing = Guidance(target, 0.0, rule="paper")
    assert torch.equal(sample_large(mix, SCHEDULE, condition, NATIVE, **common, guidance=nothing), plain)
    strong = Guidance(target, 1e5, torch.ones(2, 1, 50, 71))
    found = sample_large(mix, SCHEDULE, condition, NATIVE, **common, guidance=strong)
    assert float((found - target).abs().max()) < 0.05
    assert float((plain - target).abs().max()) > 0.5
    origins = list(patch_origins(50, 71, NATIVE, 0.5))
    assert strong.report.updates == 4 * 2 * (1 + len(origins))


def test_report_without_guidance():
    report = GuidanceReport()
    patches = PatchSettings(strength=1e6, rule="paper")
    settings = SamplerSettings(2)
    sample_large(
        mix, SCHEDULE, random(1, 1, 33, 32), NATIVE, channels=1, seeds=[0], settings=settings, patches=patches, report=report
    )
    assert (report.updates, report.bounded) == (4, 4)


def test_clear_errors():
    condition, common = torch.zeros(2, 1, 40, 40), {"channels": 1, "settings": SamplerSettings(2)}
    with pytest.raises(InputError, match="condition"):
        sample_large(mix, SCHEDULE, condition, NATIVE, seeds=[0], **common)
    with pytest.raises(InputError, match="foreground"):
        sample_large(mix, SCHEDULE, condition, NATIVE, seeds=[0, 1], **common, foreground=torch.zeros(2, 40, 40))
