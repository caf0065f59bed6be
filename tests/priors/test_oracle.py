"""Every dial of the oracle against its docstring: exactly where it is deterministic, statistically where it is random.

Random dials are judged over many views, with tolerances of about four standard errors; seeds are fixed.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations
from ia_bench.priors.oracle import OraclePrior
from ia_bench.runs.scene import ToldPrior
from ia_bench.scenes.scene import Camera, View

HEIGHT, WIDTH = 12, 16


def pictures(count: int, *, height: int = HEIGHT, width: int = WIDTH) -> Observations:
    """Random ones with a soft-edged disc as coverage; albedo stays within [0.2, 0.6]."""
    random = np.random.default_rng(0)
    row, column = np.mgrid[:height, :width]
    mask = np.clip(0.42 * min(height, width) + 0.5 - np.hypot(row - height / 2, column - width / 2), 0, 1).astype(np.float32)
    ranges = (0.1, 2.0), (0.2, 0.6), (0.0, 3.0)
    drawn = [[random.uniform(*ends, (height, width, 3)) for ends in ranges] for _ in range(count)]
    images, albedo, specular = torch.from_numpy((mask[..., None] * np.array(drawn)).astype(np.float32)).unbind(1)
    return Observations(images, torch.from_numpy(mask).repeat(count, 1, 1), truth={"albedo": albedo, "specular": specular})


def draw(prior: OraclePrior, known: Observations, seed: int = 0, **guidance: Tensor) -> Mapping[str, Tensor]:
    return prior.sample(known, seed=seed, guidance=guidance or None).values


def truth_of(known: Observations, component: str) -> np.ndarray:
    return known.truth[component].double().numpy()


def unit_of(known: Observations, component: str) -> float:
    """Mean of the component over the pixels of the scene where it is not zero."""
    truth = truth_of(known, component)
    return float(truth[truth.sum(-1) > 0].mean())


def test_scale_is_one_log_normal_factor_per_view() -> None:
    known = pictures(400, height=4, width=5)
    truth, inside = truth_of(known, "specular"), truth_of(known, "specular") > 0.01  # an albedo would be cut at 1
    sample = draw(OraclePrior(scale=0.3), known)["specular"].numpy()
    factors = [s[i] / t[i] for s, t, i in zip(sample, truth, inside, strict=True)]
    assert max(np.abs(of_view / of_view[0] - 1).max() for of_view in factors) < 1e-5
    logs = np.log([of_view[0] for of_view in factors])
    assert abs(logs.mean()) < 4 * 0.3 / math.sqrt(400)
    assert abs(logs.std() / 0.3 - 1) < 4 / math.sqrt(800)


def test_noise_is_white_with_the_stated_deviation() -> None:
    known = pictures(40, height=24, width=31)
    sample = draw(OraclePrior(noise=0.1), known)["albedo"].numpy()
    full = known.masks[0].numpy() == 1
    noise = ((sample - truth_of(known, "albedo")) / unit_of(known, "albedo"))[:, full]
    assert abs(noise.std() / 0.1 - 1) < 4 / math.sqrt(2 * noise.size)
    assert abs(noise.mean()) < 4 * 0.1 / math.sqrt(noise.size)
    correlation = np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1]
    assert abs(correlation) < 4 / math.sqrt(noise.size)


def test_baked_shading_multiplies_the_albedo_alone() -> None:
    known = pictures(2)
    samples = draw(OraclePrior(baked=0.5), known)
    np.testing.assert_array_equal(samples["specular"].numpy(), truth_of(known, "specular").astype(np.float32))
    luminance = known.images.double().numpy() @ [0.2126, 0.7152, 0.0722]
    factor = np.sqrt(luminance / (luminance.sum((1, 2)) / known.masks.numpy().sum((1, 2)))[:, None, None])
    np.testing.assert_allclose(samples["albedo"].numpy(), truth_of(known, "albedo") * factor[..., None], rtol=1e-4, atol=1e-6)


def test_inconsistency_is_smooth_and_differs_between_views() -> None:
    known = pictures(6, height=48, width=64)
    sample = draw(OraclePrior(inconsistency=0.1, patch=4.0), known)["albedo"].numpy()
    full = known.masks[0].numpy() == 1
    field = (sample - truth_of(known, "albedo")) / unit_of(known, "albedo")
    assert abs(field[:, full].std() / 0.1 - 1) < 0.35  # few patches per view, hence the wide band
    near, far = (np.corrcoef(field[:, 24, 20:36].ravel(), field[:, 24 + d, 20:36].ravel())[0, 1] for d in (1, 12))
    assert near > 0.9
    assert abs(far) < 0.5
    between = np.corrcoef(field[0][full].ravel(), field[1][full].ravel())[0, 1]
    assert abs(between) < 0.5


@pytest.mark.parametrize("strength", [0.5, 100.0, 1e6])
def test_guidance_is_the_gaussian_posterior_mean(strength: float) -> None:
    known = pictures(2)
    dials = {"scale": 0.1, "noise": 0.05, "inconsistency": 0.3}
    generator, coverage = torch.Generator().manual_seed(3), known.masks[..., None]
    render = {n: coverage * torch.rand(2, HEIGHT, WIDTH, 3, generator=generator) for n in ("albedo", "specular")}
    free = draw(OraclePrior(**dials), known, 4)
    guided = draw(OraclePrior(**dials, guidance_strength=strength), known, 4, **render)
    inside = known.masks.numpy() > 0
    for name in ("albedo", "specular"):
        truth = truth_of(known, name)
        variance = unit_of(known, name) ** 2 * (0.05**2 + 0.3**2) + (0.1 * truth) ** 2
        x, r = free[name].double().numpy(), render[name].double().numpy()
        expected = (x / variance + strength * r) / (1 / variance + strength)
        np.testing.assert_allclose(guided[name].numpy()[inside], expected[inside], rtol=2e-5, atol=2e-6)


def test_strength_zero_and_no_variance_return_the_sample_to_the_bit() -> None:
    known = pictures(2)
    render = {name: torch.ones(2, HEIGHT, WIDTH, 3) for name in ("albedo", "specular")}
    noisy = {"noise": 0.3, "scale": 0.2}
    for options, same in (({**noisy, "guidance_strength": 0.0}, noisy), ({"guidance_strength": 1e9}, {})):
        guided, free = draw(OraclePrior(**options), known, 7, **render), draw(OraclePrior(**same), known, 7)
        assert all(torch.equal(guided[name], free[name]) for name in free)


def test_draws_depend_on_seed_and_view_and_on_nothing_else() -> None:
    more = pictures(5)
    first = more.select([0, 1])
    dials = {"scale": 0.2, "noise": 0.1}
    few, many = draw(OraclePrior(**dials), first), draw(OraclePrior(**dials), more)
    # one view more changes the unit (the scene's mean) a little, and no random number at all
    assert float((few["albedo"] - many["albedo"][:2]).abs().max()) < 0.02 * float(few["albedo"].max())
    prior = OraclePrior(**dials)
    again = [draw(prior, more, seed)["albedo"] for seed in (0, 1, 0)]
    assert torch.equal(again[0], again[2])
    assert not torch.equal(again[0], again[1])
    same = more.select([0, 0, 0])  # equal views get different draws ...
    sample = draw(OraclePrior(noise=0.1), same)
    noise = [(sample[name].numpy() - truth_of(same, name))[:, 5:7, 6:10].ravel() for name in ("albedo", "specular")]
    assert not np.allclose(sample["albedo"][0], sample["albedo"][1])
    assert abs(np.corrcoef(*noise)[0, 1]) < 0.5  # ... and so do the components


def test_dark_image_and_empty_mask_stay_finite() -> None:
    known = pictures(2)
    empty = known.each(lambda tensor: torch.cat([tensor[:1], 0 * tensor[1:]]))
    dark = replace(empty, images=0 * empty.images, truth={**empty.truth, "specular": 0 * empty.images})
    dials = {"scale": 0.2, "noise": 0.2, "baked": 0.5, "inconsistency": 0.2}
    samples = draw(OraclePrior(**dials), dark)
    assert all(bool(torch.isfinite(sample).all()) and bool((sample[1] == 0).all()) for sample in samples.values())


def test_a_view_without_the_truth_is_named() -> None:
    known = pictures(1)
    image, mask, albedo = (tensor[0].numpy() for tensor in (known.images, known.masks, known.truth["albedo"]))
    lacking = View("images/train/0007", Camera(np.eye(4), (20.0, 20.0), (8.0, 6.0), 16, 12), image, mask, albedo=albedo)
    with pytest.raises(InputError, match="training view images/train/0007 has no ground-truth specular"):
        ToldPrior(OraclePrior(), lambda: (lacking,)).shown(replace(known, views=(0,)))
