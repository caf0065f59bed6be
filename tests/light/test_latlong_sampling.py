"""Sampling of the lat-long map against chi-square tests.

What the renderer's kernels compute is called as they have it (``kernel_calls``); what torch has too is tested beside it.
"""

import itertools
import math

import kernel_calls
import numpy as np
import pytest
import torch
from chi_square import assert_frequencies
from kernel_calls import normal_bin, texel_to_direction

from ia_bench.light import latlong
from ia_bench.light.latlong import BIN_RADIUS, BIN_SIDE, LatLongSampler, bin_centres

pytestmark = pytest.mark.verify


# ---------------------------------------------------------------- sampling
def lit(dark: float, *bright: tuple[object, float]) -> torch.Tensor:
    """A map of 16 x 32 texels, all of them ``dark`` but for some places."""
    radiance = torch.full((16, 32, 3), dark)
    for where, value in bright:
        radiance[where] = value
    return radiance


RANDOM = torch.rand(9, 14, 3, generator=torch.Generator().manual_seed(1)) ** 6
HOLES = torch.rand(9, 14, 1, generator=torch.Generator().manual_seed(2)) < 0.5
HOLES[0, 0] = HOLES[-1, -1] = True

MAPS = {
    "one bright texel among dark": lit(0.1, ((5, 20), 5000.0)),
    "black": torch.zeros(8, 16, 3),
    "random": RANDOM,
    "with black texels": RANDOM * ~HOLES,
    "bright pole row": lit(0.05, (0, 30.0)),
    "bright seam": lit(0.05, (np.s_[7:10, 0], 200.0), (np.s_[7:10, -1], 50.0)),  # more on one side
    "one texel of 1e6 at the pole": lit(0.1, ((0, 17), 1e6)),
    "two texels of 1e4 at the seam": lit(0.1, ((8, 0), 1e4), ((8, -1), 1e4)),
    "radiance 1e-30": lit(1e-30),
    "radiance 1e30": lit(1e30),
    "1 x 2": torch.tensor([[[1.0, 2.0, 3.0], [0.5, 0.5, 0.5]]]),
    "1 x 1": torch.ones(1, 1, 3),
    "one channel only": RANDOM * torch.tensor([0.0, 1.0, 0.0]),
}


NORMALS = torch.nn.functional.normalize(
    torch.tensor([[0.0, 0.1, 1.0], [0.2, 0.1, -1.0], [1.0, 0.05, 0.03], [-0.7, -0.7, 0.4], [-1.0, 0.02, -0.01]]), dim=-1
)
DRAWS = 100_000


def solid_angles(height: int, width: int) -> np.ndarray:
    z = np.cos(np.pi * np.arange(height + 1) / height)
    return np.repeat((z[:-1] - z[1:]) * 2 * np.pi / width, width)


def density(sampler: LatLongSampler, normal: torch.Tensor) -> np.ndarray:
    """Density (H W,) of every texel for one surface normal."""
    return kernel_calls.density(sampler, normal_bin(normal), torch.arange(sampler.height * sampler.width)).double().numpy()


def draw(sampler: LatLongSampler, normal: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    return kernel_calls.sample_texel(sampler, normal_bin(normal), u)


def test_cells_of_normals_are_as_small_as_the_margin_assumes() -> None:
    normals = torch.randn(200_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    normals = torch.cat([normals, torch.eye(3).double(), -torch.eye(3).double()])
    normals = normals / normals.norm(dim=-1, keepdim=True)
    cells = normal_bin(normals)
    assert torch.equal(cells.unique(), torch.arange(BIN_SIDE**2))
    centres = bin_centres()
    assert torch.equal(normal_bin(centres), torch.arange(BIN_SIDE**2))
    angle = torch.acos((normals * centres[cells]).sum(-1).clamp(-1, 1))
    assert BIN_RADIUS - 0.03 < float(angle.max()) < BIN_RADIUS  # as large as 200 000 normals find it, and no larger


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.25])
@pytest.mark.parametrize("name", MAPS)
def test_texels_are_drawn_by_their_density(name: str, uniform_fraction: float) -> None:
    """Chi-square over all texels for five normals, 100 000 draws each; false alarms in chi_square.py."""
    radiance = MAPS[name]
    height, width, _ = radiance.shape
    sampler = LatLongSampler.build(radiance, uniform_fraction=uniform_fraction)
    for seed, normal in enumerate(NORMALS):
        u = torch.rand(DRAWS, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        counts = np.bincount(draw(sampler, normal, u).numpy(), minlength=height * width)
        expected = density(sampler, normal) * solid_angles(height, width)
        assert_frequencies(counts, DRAWS * expected, tests=2 * len(MAPS) * len(NORMALS))


@pytest.mark.parametrize("name", MAPS)
def test_density_is_proportional_to_radiance(name: str) -> None:
    """Over a constant map the density is the bound of the cosine alone; what remains is the mean of the channels."""
    radiance = MAPS[name]
    height, width, _ = radiance.shape
    brightness = radiance.double().mean(-1).flatten().numpy()
    for normal in NORMALS:
        bound = density(LatLongSampler.build(torch.ones(height, width, 3)), normal)
        expected = bound * brightness if (bound * brightness).sum() > 0 else bound
        expected = expected / (expected * solid_angles(height, width)).sum()
        found = density(LatLongSampler.build(radiance), normal)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=0)
        mixed = density(LatLongSampler.build(radiance, uniform_fraction=0.25), normal)
        np.testing.assert_allclose(mixed, 0.75 * found + 0.25 * bound, rtol=1e-4, atol=0)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_texel_that_is_no_number_is_refused(value: float) -> None:
    radiance = torch.ones(16, 32, 3)
    radiance[3, 5, 1] = value
    with pytest.raises(FloatingPointError, match="light"):
        LatLongSampler.build(radiance)


def test_large_maps_are_looked_at_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the same last bit: 64 cells of a map of 4096 x 8192 texels would take 60 GB at once."""
    whole = latlong.sampling_grid.__wrapped__(32, 64, torch.device("cpu"))
    monkeypatch.setattr(latlong, "AT_ONCE", 5 * 32 * 64)
    parts = latlong.sampling_grid.__wrapped__(32, 64, torch.device("cpu"))
    assert all(torch.equal(one, other) for one, other in zip(whole, parts, strict=True))


@pytest.mark.parametrize("height", [1, 2, 16, 32, 64])
def test_every_direction_that_can_light_a_normal_can_be_drawn(height: int) -> None:
    """Wherever n.d > 0 in a lit texel the density is at least a share of what cosine-weighted sampling would give.

    The texel is judged by its centre, the normal by its cell's: both distances must be allowed for.
    """
    sampler = LatLongSampler.build(torch.ones(height, 2 * height, 3))
    rng = torch.Generator().manual_seed(5)
    normal, direction = (
        torch.nn.functional.normalize(torch.randn(200_000, 3, dtype=torch.float64, generator=rng), dim=-1) for _ in range(2)
    )
    cosine = (normal * direction).sum(-1)
    texel = latlong.direction_to_texel(direction, height, 2 * height)
    found = kernel_calls.density(sampler, normal_bin(normal), texel).double()
    ratio = (found * math.pi / cosine)[cosine > 1e-3]
    assert float(ratio.min()) > 0.2


@pytest.mark.parametrize(
    "name", ["random", "bright pole row", "bright seam", "one bright texel among dark", "black", "1 x 2", "1 x 1"]
)
def test_directions_follow_the_density_within_texels_too(name: str) -> None:
    """Draws are counted in a grid four times as fine in cos(theta) and phi: equal solid angles in each texel.

    For a normal toward the azimuth seam; false alarms in chi_square.py.
    """
    normal = NORMALS[4]
    radiance = MAPS[name]
    height, width, _ = radiance.shape
    sampler = LatLongSampler.build(radiance)
    rng = torch.Generator().manual_seed(4)
    texel = draw(sampler, normal, torch.rand(DRAWS, dtype=torch.float64, generator=rng))
    direction = texel_to_direction(texel, *torch.rand(2, DRAWS, generator=rng), height, width).double().numpy()
    z = np.cos(np.pi * np.arange(height + 1) / height)
    edges = np.concatenate([np.linspace(a, b, 4, endpoint=False) for a, b in itertools.pairwise(z)] + [z[-1:]])
    row = np.clip(np.searchsorted(-edges, -direction[:, 2], side="right") - 1, 0, 4 * height - 1)
    phi = np.arctan2(direction[:, 1], direction[:, 0])
    column = np.clip(((np.pi - phi) / (2 * np.pi) * 4 * width).astype(int), 0, 4 * width - 1)
    counts = np.bincount(row * 4 * width + column, minlength=16 * height * width)
    expected = (density(sampler, normal) * solid_angles(height, width)).reshape(height, width)
    assert_frequencies(counts, DRAWS * np.repeat(np.repeat(expected, 4, axis=0), 4, axis=1) / 16, tests=7)


def test_dark_texels_beside_a_sun_keep_their_share() -> None:
    """A sun of 1e7 beside texels of 1, which a running sum in float32 would swallow.

    Bisection finds the numbers that draw the sun, as many as its probability; chi-square tests what the others draw.
    """
    radiance = torch.ones(64, 128, 3)
    radiance[20, 60] = 1e7
    sun = 20 * 128 + 60
    sampler = LatLongSampler.build(radiance)
    seen = 0
    for seed, normal in enumerate(NORMALS):
        expected = density(sampler, normal) * solid_angles(64, 128)
        if expected[sun] == 0:
            continue
        seen += 1
        ends = []
        for outside in (0.0, 1.0):
            inside = 0.5
            for _ in range(50):
                middle = 0.5 * (outside + inside)
                if int(draw(sampler, normal, torch.tensor([middle], dtype=torch.float64))) == sun:
                    inside = middle
                else:
                    outside = middle
            ends.append(inside)
        dark = 1 - (ends[1] - ends[0])
        assert dark == pytest.approx(np.delete(expected, sun).sum(), rel=1e-4)
        u = dark * torch.rand(DRAWS, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        u = torch.where(u < ends[0], u, u - ends[0] + ends[1])
        counts = np.bincount(draw(sampler, normal, u).numpy(), minlength=64 * 128)
        assert_frequencies(np.delete(counts, sun), DRAWS * np.delete(expected, sun) / dark, tests=len(NORMALS))
    assert seen >= 2


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.25])
@pytest.mark.parametrize(("sun", "drawn_to"), [(1e6, 1e-5), (1e8, 3e-3)])
@pytest.mark.parametrize("where", [(0, 0), (5, 16), (15, 31)])
def test_shares_beside_a_sun_are_of_float64(where: tuple[int, int], sun: float, drawn_to: float, uniform_fraction: float) -> None:
    """Of every texel, for every cell of normals: its density, and its share of the tables by which texels are drawn."""
    radiance = 0.1 + torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(1))
    radiance[where] = sun
    sampler = LatLongSampler.build(radiance, uniform_fraction=uniform_fraction)
    cells, (order, block) = torch.arange(BIN_SIDE**2), (sampler.grid.order.long(), sampler.grid.block.long())
    evenly = sampler.grid.bound.double()[:, block] * torch.from_numpy(solid_angles(16, 32))
    lit = evenly * radiance.double().mean(-1).flatten()
    expected = (1 - uniform_fraction) * lit / lit.sum(1, keepdim=True) + uniform_fraction * evenly / evenly.sum(1, keepdim=True)

    found = kernel_calls.density(sampler, cells[:, None], torch.arange(16 * 32)).double() * torch.from_numpy(solid_angles(16, 32))
    torch.testing.assert_close(found, expected, rtol=2e-6, atol=0)

    entries = torch.cat([torch.zeros(64, 1), sampler.entries[1:].reshape(64, -1) - cells[:, None]], 1).diff().reshape(64, 2, -1)
    steps = torch.cat([torch.zeros(1), sampler.texels]).diff().reshape(2, -1) / sampler.edges.diff().reshape(2, -1)[:, block[order]]
    drawn = torch.zeros_like(expected)
    drawn[:, order] = (entries[:, :, block[order]] * steps).sum(1)
    torch.testing.assert_close(drawn, expected, rtol=drawn_to, atol=0)
