"""Large images: exact where the denoiser returns its condition, the same whatever is sampled beside, and without seams.

The prior of the seam tests is a stationary Gaussian field with correlation length ELL, on each patch with its exact covariance:
a sample of one patch has the same gradient energy everywhere, so whatever differs comes from putting patches together.
"""

import itertools
import math
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from ia_bench.priors.diffusion import patches
from ia_bench.priors.diffusion.guidance import Guidance, Pull, Rule
from ia_bench.priors.diffusion.patches import MakeDenoise, patch_origins, sample_large
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule, SamplerSettings, sample

SCHEDULE = NoiseSchedule(torch.cos(torch.linspace(0.02, 1.56, 200, dtype=torch.float64)).square())
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


def large(
    make: MakeDenoise,
    condition: Tensor,
    settings: SamplerSettings,
    *,
    channels: int = 1,
    seeds: Sequence[int] | None = None,
    batch: int = 64,
    foreground: Tensor | None = None,
    guidance: Guidance | None = None,
) -> Tensor:
    """One sample of one channel of each image, object everywhere, unguided, seeds 0, 1, ..., but for what is given."""
    whole = torch.ones(len(condition), 1, *condition.shape[-2:]) if foreground is None else foreground
    seeds, like = seeds or range(len(condition)), (channels, NATIVE, NATIVE)
    return sample_large(make, SCHEDULE, like, condition, whole, seeds, settings, guidance or Guidance(), batch=batch)


@pytest.mark.parametrize("side", [33, 37, 48, 64, 90, 107, 333])
def test_patches_cover_everything_and_overlap(side: int):
    origins = list(patch_origins(side, 32))
    covered = torch.zeros(side, side, dtype=torch.bool)
    for top, left in origins:
        assert 0 <= top <= side - 32
        assert 0 <= left <= side - 32
        covered[top : top + 32, left : left + 32] = True
    assert bool(covered.all())
    for axis in (0, 1):
        starts = sorted({origin[axis] for origin in origins})
        assert all(0 < b - a <= 16 for a, b in itertools.pairwise(starts))


@pytest.mark.parametrize("side", [33, 64, 101])
def test_a_denoiser_that_returns_its_condition_gives_it_back_exactly(side: int, monkeypatch: pytest.MonkeyPatch):
    condition, settings = random(2, 3, side, side), SamplerSettings(3, eta=0.5)
    flat = condition[..., :1, :1].expand_as(condition)  # coarse and fine agree: guidance has nothing to change
    torch.testing.assert_close(large(give_back, flat, settings, channels=3), flat, rtol=0, atol=1e-5)
    monkeypatch.setattr(patches, "STRENGTH", {"squared": 0.0})
    assert torch.equal(large(give_back, condition, settings, channels=3), condition)


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_an_image_depends_neither_on_its_neighbours_nor_on_the_batch(eta: float, monkeypatch: pytest.MonkeyPatch):
    condition, settings = random(3, 1, 71, 71), SamplerSettings(4, eta)

    def both() -> tuple[Tensor, Tensor]:
        together = large(mix, condition, settings, channels=2, seeds=[7, 0, 5], batch=5)
        return together[2:], large(mix, condition[2:], settings, channels=2, seeds=[5])

    torch.testing.assert_close(*both(), rtol=0, atol=1e-5)  # the blur of guided ones is a product of matrices
    monkeypatch.setattr(patches, "STRENGTH", {"squared": 0.0})
    assert torch.equal(*both())


def test_patches_without_foreground_are_skipped(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(patches, "STRENGTH", {"squared": 0.0})
    condition, foreground, settings = random(2, 1, 96, 96), torch.zeros(2, 1, 96, 96), SamplerSettings(3)
    foreground[0, 0, :20, :20] = 1
    calls = []

    def counting(batch: Tensor) -> Denoise:
        calls.append(len(batch))
        return mix(batch)

    found = large(counting, condition, settings, foreground=foreground)
    assert calls == [2, 4]  # coarse images, then the patches at (0, 16) x (0, 16)
    everything = large(mix, condition, settings)
    assert torch.equal(found[0, :, :16, :16], everything[0, :, :16, :16])
    coarse = large(mix, condition, settings, foreground=torch.zeros_like(foreground))
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
def test_no_seams(strength: float, eta: float, monkeypatch: pytest.MonkeyPatch):
    """Within 5 %: the ratio scatters by 1.2 % (24 images x 3 channels x 107 rows, 20 lines), so four sigma; seeds are fixed."""
    monkeypatch.setattr(patches, "STRENGTH", {"squared": strength})
    found = large(field_prior(NATIVE), torch.zeros(24, 1, 107, 107), SamplerSettings(10, eta, clip=None), channels=3)
    lines = sorted({line for origin, _ in patch_origins(107, NATIVE) for line in (origin, origin + NATIVE)})
    energies = [gradient_energy(image, lines[1:-1], margin=4) for image in (found, found.mT)]
    border, other = (sum(part) for part in zip(*energies, strict=True))
    assert abs(border / other - 1) < 0.05, f"gradient energy across patch borders / elsewhere = {border / other:.3f}"


def test_patches_follow_the_coarse_sample(monkeypatch: pytest.MonkeyPatch):
    """With correlations as long as a patch, unguided patches drift from the coarse sample; guided ones follow it."""
    condition, settings = torch.zeros(4, 1, 96, 96), SamplerSettings(10, clip=None)
    coarse = sample(field_prior(NATIVE, 8.0)(condition), SCHEDULE, (4, 3, NATIVE, NATIVE), range(4), settings)
    errors = {}
    for strength in (0.0, 100.0):
        monkeypatch.setattr(patches, "STRENGTH", {"squared": strength})
        found = large(field_prior(NATIVE, 8.0), condition, settings, channels=3)
        reduced = torch.nn.functional.avg_pool2d(Pull(found, 1.0, sigma=1.5).blurred(found), 3)
        errors[strength] = float((reduced - coarse).square().mean() / coarse.square().mean())
    assert errors[0.0] > 0.5
    assert errors[100.0] < 0.1


@pytest.mark.parametrize("rule", ["variance", "paper"])
def test_guidance_reaches_coarse_and_patches(rule: Rule):
    condition, target, settings = random(2, 1, 71, 71), random(2, 1, 71, 71, seed=1), SamplerSettings(4)
    plain, strong = Guidance(), Guidance((Pull(target, 1e5, torch.ones(2, 1, 71, 71)),), rule)
    before = large(mix, condition, settings, guidance=plain)
    found = large(mix, condition, settings, guidance=strong)
    assert float((before - target).abs().max()) > 0.5
    if rule == "variance":
        assert float((found - target).abs().max()) < 0.05
    else:  # its steps are cut at the minimum along a line, which is counted
        assert strong.cost["guided_cut"] > 0
    fine = 4 * 2 * len(list(patch_origins(71, NATIVE)))
    assert not plain.cost, "patches are drawn to the coarse sample, which is no guidance of a run"
    assert strong.cost["guided_estimates"] == fine + 4 * 2
