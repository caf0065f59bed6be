"""Environment lights with everything in one texel, with nothing in them, at the poles, at the seam, and out of range."""

from __future__ import annotations

from collections.abc import Iterator

import kernel_calls
import torch
from kernel_calls import density
from stability.case import Case, Measured, all_finite, refused
from torch import Tensor

from ia_bench.light.latlong import LatLongSampler, row_solid_angles

GROUP = "light"
DRAWS = 200_000


def cases() -> Iterator[Case]:
    """All of them."""
    for extreme, radiance in _maps().items():
        quantity, reference = "integral of the density, worst of 64 normals", "1"
        yield Case(GROUP, extreme, quantity, reference, 1e-4, lambda m=radiance: _integral(m))
        quantity, reference = "share of samples by row, in standard errors", "density x solid angle"
        yield Case(GROUP, extreme, quantity, reference, 5.5, lambda m=radiance: _shares(m))
    for name, bad in (("NaN", float("nan")), ("Inf", float("inf"))):
        yield Case(GROUP, f"one texel of {name}", "sampling tables", "refused", 0.0, lambda b=bad: _bad_texel(b))


def _maps() -> dict[str, Tensor]:
    dim = torch.full((128, 256, 3), 0.1)
    texel, pole, seam, tiny, huge = (dim.clone() for _ in range(5))
    texel[40, 100] = 1e6
    pole[0, 17] = 1e6
    seam[64, 0] = seam[64, -1] = 1e4
    return {
        "one texel of 1e6": texel,
        "one texel of 1e6 at the pole": pole,
        "two texels of 1e4 at the seam": seam,
        "black": torch.zeros(16, 32, 3),
        "1 x 2 texels": torch.tensor([[[1.0, 1.0, 1.0], [3.0, 3.0, 3.0]]]),
        "radiance 1e-30": 1e-29 * tiny,
        "radiance 1e30": 1e31 * huge,
    }


def _solid_angles(radiance: Tensor) -> Tensor:
    height, width, _ = radiance.shape
    return row_solid_angles(height, width).repeat_interleave(width)


def _integral(radiance: Tensor) -> Measured:
    sampler = LatLongSampler.build(radiance, uniform_fraction=0.2)
    texels = torch.arange(radiance.shape[0] * radiance.shape[1])
    found = density(sampler, torch.arange(64)[:, None], texels[None]).double()
    return Measured(float(((found * _solid_angles(radiance)).sum(1) - 1).abs().max()), finite=all_finite(found))


def _shares(radiance: Tensor) -> Measured:
    """Of the normal that looks at the brightest texel; rows that hold less than 20 expected draws are pooled."""
    height, width, _ = radiance.shape
    sampler = LatLongSampler.build(radiance, uniform_fraction=0.2)
    cell = torch.tensor([0])
    mass = density(sampler, cell[:, None], torch.arange(height * width)[None])[0].double() * _solid_angles(radiance)
    u = torch.rand(DRAWS, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    drawn = kernel_calls.sample_texel(sampler, cell.expand(DRAWS), u)
    expected = mass.reshape(height, width).sum(1) * DRAWS
    found = torch.bincount(drawn // width, minlength=height).double()
    rare = expected < 20
    expected = torch.cat([expected[~rare], expected[rare].sum()[None]])
    found = torch.cat([found[~rare], found[rare].sum()[None]])
    spread = (expected * (1 - expected / DRAWS)).clamp_min(1.0).sqrt()
    return Measured(float(((found - expected) / spread).abs().max()))


def _bad_texel(value: float) -> Measured:
    radiance = torch.ones(16, 32, 3)
    radiance[3, 5, 1] = value
    return refused(lambda: LatLongSampler.build(radiance), FloatingPointError, "light")
