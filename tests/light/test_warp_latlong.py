"""The kernels of the light's sampler against the same in torch, number by number; what they must do: test_latlong.py."""

from __future__ import annotations

import kernel_calls
import pytest
import torch

from benchmarks import reference
from ia_bench.light.latlong import LatLongSampler

pytestmark = pytest.mark.verify


def maps() -> dict[str, torch.Tensor]:
    rng = torch.Generator().manual_seed(1)
    bright = torch.full((16, 32, 3), 0.1)
    bright[5, 20] = 1e6
    holes = torch.rand(37, 71, 3, generator=rng) ** 6
    holes[torch.rand(37, 71, generator=rng) < 0.5] = 0
    return {"black": torch.zeros(8, 16, 3), "1 x 1": torch.ones(1, 1, 3), "bright texel": bright, "holes": holes}


MAPS = maps()


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.25])
@pytest.mark.parametrize("name", MAPS)
def test_the_kernels_are_the_reference(name: str, uniform_fraction: float) -> None:
    """The same cells, the same texels by the same numbers, the same densities."""
    sampler = LatLongSampler.build(MAPS[name], uniform_fraction=uniform_fraction)
    rng = torch.Generator().manual_seed(7)
    normal = torch.nn.functional.normalize(torch.randn(2000, 3, generator=rng), dim=-1)
    cell = kernel_calls.normal_bin(normal)
    assert torch.equal(cell, reference.normal_bin(normal))
    u = torch.rand(2000, 8, dtype=torch.float64, generator=rng)
    u[:, 0], u[:, 1] = 0, 1 - 2**-24
    texel = kernel_calls.sample_texel(sampler, cell[:, None], u)
    assert torch.equal(texel, reference.sample_texel(sampler, cell[:, None], u).long())
    found = kernel_calls.density(sampler, cell[:, None], texel)
    torch.testing.assert_close(found, reference.density(sampler, cell[:, None], texel), rtol=1e-6, atol=0)
    assert (found > 0).all()


def test_directions_are_the_references() -> None:
    """The same as in float64, to a rounding of z: what moves a direction by 1e-7 moves it by 1e-7 / sine at the poles.

    And back to texels, which differ at borders alone.
    """
    rng = torch.Generator().manual_seed(8)
    height, width = 256, 512
    texel = torch.randint(height * width, (5000,), generator=rng)
    u, v = torch.rand(2, 5000, generator=rng)
    found = kernel_calls.texel_to_direction(texel, u, v, height, width)
    wanted = reference.texel_to_direction(texel.double(), u.double(), v.double(), height, width)
    error = (found.double() - wanted).norm(dim=-1)
    assert float((error * wanted[:, :2].norm(dim=-1)).max()) < 3e-7
    back = kernel_calls.direction_to_texel(found, height, width)
    assert float((back != reference.direction_to_texel(found, height, width)).float().mean()) < 1e-3
