"""What surrounds a prior: exposure, alignment of its samples, noise schedules at both ends, guidance from 0 to 1000."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from stability.case import Case, Measured, all_finite, deviation
from torch import Tensor

from ia_bench.methods.couplings.targets import align_views
from ia_bench.priors.diffusion.encoding import decode, encode, exposure
from ia_bench.priors.diffusion.guidance import Guidance, Norm, Pull, Rule
from ia_bench.priors.diffusion.sampler import NoiseSchedule, SamplerSettings, sample
from ia_bench.scenes.color import tone_map

SHAPE = (2, 3, 24, 24)
MEAN, VARIANCE, TARGET = 0.1, 0.1, 0.5  # of the Gaussian whose denoiser is known, and what guidance pulls to


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _exposures()
    yield from _alignments()
    yield from _guidance()


# ---- exposure and encodings --------------------------------------------------------------------------------------------


def _exposures() -> Iterator[Case]:
    group, what = "exposure", "exposure factor"
    yield Case(group, "empty mask", what, "1", 0.0, lambda: _exposure(torch.ones(8, 8, 3), torch.zeros(8, 8), 1.0))
    yield Case(group, "black image", what, "1", 0.0, lambda: _exposure(torch.zeros(8, 8, 3), torch.ones(8, 8), 1.0))
    one = torch.zeros(8, 8)
    one[3, 4] = 1
    bright = 1e6 * one[..., None].expand(8, 8, 3)
    yield Case(group, "one pixel of 1e6", what, "0.7 / 1e6", 1e-6, lambda: _exposure(bright, one, 0.7e-6))
    yield Case(group, "radiance from 1e-30 to 1e30", "tone map", "float64; gradient: float64", 1e-5, _tone_map, 1e-4)
    yield Case(group, "albedo stored in half precision", "encoding and back", "float64", 2e-3, _half)


def _exposure(image: Tensor, mask: Tensor, expected: float) -> Measured:
    found = exposure(image[None], mask[None])
    return Measured(deviation(found, torch.tensor([expected], dtype=torch.float64)), finite=all_finite(found))


def _tone_map() -> Measured:
    radiance = torch.logspace(-30, 30, 200).requires_grad_(True)
    value = tone_map(radiance)
    (slope,) = torch.autograd.grad(value.sum(), radiance)
    exact = radiance.detach().double().requires_grad_(True)
    reference = tone_map(exact)
    (steep,) = torch.autograd.grad(reference.sum(), exact)
    error = deviation(value.detach(), reference.detach(), 1e-12)
    return Measured(error, deviation(slope, steep, 1e-12), finite=all_finite(value, slope))


def _half() -> Measured:
    albedo = torch.rand(4, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    masks = torch.ones(4, 8, 8)
    one = torch.ones(4)
    back = decode("albedo", encode("albedo", albedo.half().float(), masks, one).half().float(), masks, one)
    return Measured(deviation(back, albedo, 0.1), finite=all_finite(back))


# ---- scale-and-shift alignment -----------------------------------------------------------------------------------------


def _alignments() -> Iterator[Case]:
    group = "SSI"
    generator = torch.Generator().manual_seed(0)
    varied = torch.rand(64, 3, generator=generator)
    constant, zero = torch.full((64, 3), 0.3), torch.zeros(64, 3)
    for mode in ("scale", "scale_shift"):
        what = f"alignment, {mode}"
        exact = "target"
        yield Case(group, "prediction 1e-3 of the target", what, exact, 1e-4, lambda m=mode: _aligned(1e-3 * varied, varied, m))
        yield Case(group, "prediction 1e3 times the target", what, exact, 1e-4, lambda m=mode: _aligned(1e3 * varied, varied, m))
        yield Case(group, "constant prediction and target", what, exact, 1e-5, lambda m=mode: _aligned(constant, 2 * constant, m))
        yield Case(group, "zero prediction", f"scale, {mode}", "1", 0.0, lambda m=mode: _scale(zero, varied, m, 1.0))
        yield Case(group, "a view without pixels", f"scale, {mode}", "1", 0.0, lambda m=mode: _scale(zero[:0], zero[:0], m, 1.0))
    yield Case(group, "negative prediction", "scale, scale", "1", 0.0, lambda: _scale(-varied, varied, "scale", 1.0))


def _aligned(prediction: Tensor, target: Tensor, mode: str) -> Measured:
    view = torch.zeros(len(prediction), dtype=torch.long)
    found = align_views(prediction, target, view, 1, mode)(prediction, view, torch.ones(len(view), 1))
    return Measured(deviation(found, target, 1e-2), finite=all_finite(found))


def _scale(prediction: Tensor, target: Tensor, mode: str, expected: float) -> Measured:
    found = align_views(prediction, target, torch.zeros(len(prediction), dtype=torch.long), 1, mode)
    return Measured(abs(float(found.scale[0]) - expected), finite=all_finite(found.scale, found.shift))


# ---- guidance ----------------------------------------------------------------------------------------------------------


def _guidance() -> Iterator[Case]:
    group = "guidance"
    for strength in (1e-3, 1.0, 1e3):
        what, reference = "mean of 3 456 samples, in posterior standard deviations", "closed form"
        extreme = f"strength {strength:g}, rule variance, 300 steps"
        yield Case(group, extreme, what, reference, 0.1, lambda s=strength: _posterior(s))
    yield Case(group, "strength 0", "sample", "the unguided one, to the bit", 0.0, lambda: _strength_zero())
    for rule, norm in (("variance", "squared"), ("paper", "squared"), ("paper", "l2")):
        for steps in (1, 1000):
            extreme = f"strength 1000, {steps} step{'s' * (steps > 1)}, rule {rule}, {norm}"
            yield Case(
                group, extreme, "samples beyond [-1, 1]", "0", 0.0,
                lambda r=rule, n=norm, s=steps: _in_range(r, n, s),
            )  # fmt: skip
    for norm in ("squared", "l2"):
        extreme = f"a target that is already reached, rule paper, {norm}"
        yield Case(group, extreme, "sample", "the unguided one", 1e-6, lambda n=norm: _arrived(n))
    yield Case(group, "half of the pixels without weight", "these pixels", "the unguided ones", 0.0, _half_weighted)
    yield Case(group, "a target of noise of standard deviation 100", "samples beyond [-1, 1]", "0", 0.0, _noisy_target)


def _wide(steps: int) -> NoiseSchedule:
    return NoiseSchedule(1 / (1 + torch.logspace(-4, 4, steps, dtype=torch.float64).square()))


def _draw(guidance: Guidance | None, steps: int, *, clip: bool, variance: float = VARIANCE) -> Tensor:
    """Samples of N(MEAN, variance), value by value, whose denoiser is known in closed form."""
    schedule = _wide(max(steps, 300))

    def denoise(noisy: Tensor, t: int) -> Tensor:
        level = float(schedule.alpha_bar[t])
        return (variance * math.sqrt(level) * noisy + (1 - level) * MEAN) / (variance * level + 1 - level)

    settings = SamplerSettings(steps, clip=(-1.0, 1.0) if clip else None)
    return sample((guidance or Guidance()).guiding(denoise, schedule), schedule, SHAPE, list(range(SHAPE[0])), settings)


def _pull(strength: float, rule: Rule = "variance", norm: Norm = "squared", target: Tensor | None = None) -> Guidance:
    wanted = torch.full(SHAPE, TARGET) if target is None else target
    return Guidance((Pull(wanted, strength),), rule, norm, VARIANCE)


def _posterior(strength: float) -> Measured:
    found = _draw(_pull(strength), 300, clip=False)
    variance = 1 / (1 / VARIANCE + strength)
    mean = variance * (MEAN / VARIANCE + strength * TARGET)
    return Measured(abs(float(found.double().mean()) - mean) / math.sqrt(variance), finite=all_finite(found))


def _strength_zero() -> Measured:
    guided, plain = _draw(_pull(0.0), 20, clip=True), _draw(None, 20, clip=True)
    return Measured(float((guided != plain).double().mean()), finite=all_finite(guided))


def _in_range(rule: Rule, norm: Norm, steps: int) -> Measured:
    guidance = _pull(1e3, rule, norm)
    found = _draw(guidance, steps, clip=True)
    return Measured(max(0.0, float(found.abs().max()) - 1), finite=all_finite(found))


def _arrived(norm: Norm) -> Measured:
    """All data are MEAN, and so is the target: the residual is zero throughout, and its norm has no gradient."""
    guidance = _pull(10.0, "paper", norm, torch.full(SHAPE, MEAN))
    found, plain = _draw(guidance, 50, clip=True, variance=0.0), _draw(None, 50, clip=True, variance=0.0)
    return Measured(deviation(found, plain, 1e-2), finite=all_finite(found))


def _half_weighted() -> Measured:
    weight = torch.ones(SHAPE)
    weight[..., ::2] = 0
    guidance = Guidance((Pull(torch.full(SHAPE, TARGET), 1e3, weight),), prior_variance=VARIANCE)
    found, plain = _draw(guidance, 50, clip=True), _draw(None, 50, clip=True)
    error = float((found - plain)[..., ::2].abs().max())
    return Measured(error, finite=all_finite(found))


def _noisy_target() -> Measured:
    target = 100 * torch.randn(SHAPE, generator=torch.Generator().manual_seed(0))
    found = _draw(_pull(1e3, target=target), 50, clip=True)
    return Measured(max(0.0, float(found.abs().max()) - 1), finite=all_finite(found))
