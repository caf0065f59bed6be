"""The lat-long map: its geometry against closed forms written out here, its sampling against chi-square tests.

What the renderer's kernels compute is called as they have it (``kernel_calls``); what torch has too is tested beside it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import kernel_calls
import numpy as np
import pytest
import torch
from chi_square import assert_frequencies
from kernel_calls import normal_bin, texel_to_direction

from ia_bench.light import latlong
from ia_bench.light.latlong import (
    BIN_RADIUS,
    BIN_SIDE,
    LatLongSampler,
    bin_centres,
    resize_light,
    row_solid_angles,
    sampling_grid,
    texel_centres,
)

pytestmark = pytest.mark.verify

SIZES = [(1, 1), (1, 2), (2, 4), (16, 32), (37, 31), (256, 512)]
BY = {"torch": latlong, "kernels": kernel_calls}


# ---------------------------------------------------------------- geometry
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_solid_angles_fill_the_sphere(height: int, width: int) -> None:
    angles = row_solid_angles(height, width)
    assert angles.dtype == torch.float64
    assert float(angles.sum()) * width == pytest.approx(4 * math.pi, rel=1e-12)
    assert (angles > 0).all()


def test_solid_angle_of_a_cap() -> None:
    """The first k of H rows are the cap of half angle pi k / H: 2 pi (1 - cos)."""
    cap = row_solid_angles(12, 24)[:5].sum() * 24
    assert float(cap) == pytest.approx(2 * math.pi * (1 - math.cos(5 * math.pi / 12)), rel=1e-12)


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_centres_come_back_to_their_texels(height: int, width: int, by: str) -> None:
    centres = texel_centres(height, width)
    torch.testing.assert_close(centres.norm(dim=-1), torch.ones(height, width))
    expected = torch.arange(height * width).reshape(height, width)
    assert torch.equal(BY[by].direction_to_texel(centres, height, width), expected)


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize(("height", "width"), [(16, 32), (37, 31), (256, 512)])
def test_every_point_of_a_texel_comes_back_to_it(height: int, width: int, by: str) -> None:
    """Corners are taken a little inside: 0.1 % of a texel is above what float32 resolves."""
    every = torch.arange(height * width)
    for u in (1e-3, 0.5, 1 - 1e-3):
        for v in (1e-3, 0.5, 1 - 1e-3):
            inside = torch.full((len(every),), u), torch.full((len(every),), v)
            direction = BY[by].texel_to_direction(every, *inside, height, width)
            torch.testing.assert_close(direction.norm(dim=-1), torch.ones(len(every)))
            assert torch.equal(BY[by].direction_to_texel(direction, height, width), every)


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize(
    ("direction", "row", "column"),
    [
        ((0, 0, 1), 0, None),  # poles: any column
        ((0, 0, -1), 7, None),
        ((0, 0, 1.0000001), 0, None),  # a unit vector in float32 may be an ulp too long
        ((1, 0, 0), 4, 8),  # phi = 0: the middle of the picture, on the border of columns 7 and 8
        ((0, 1, 0), 4, 4),  # phi = 90 degrees: left of the middle
        ((0, -1, 0), 4, 12),
        ((-1, 1e-4, 0), 4, 0),  # the seam from both sides
        ((-1, -1e-4, 0), 4, 15),
        ((-1, 0.0, 0), 4, 0),
        ((-1, -0.0, 0), 4, 15),
    ],
)
def test_poles_and_seam(direction: tuple[float, float, float], row: int, column: int | None, by: str) -> None:
    texel = int(BY[by].direction_to_texel(torch.tensor(direction, dtype=torch.float32), 8, 16))
    assert texel // 16 == row
    assert column is None or texel % 16 == column


def written_convention(row: int, column: int, height: int, width: int) -> np.ndarray:
    """scene.json: theta = pi (r+0.5)/H from +z, phi = pi - 2 pi (c+0.5)/W from +x toward +y."""
    theta = math.pi * (row + 0.5) / height
    phi = math.pi - 2 * math.pi * (column + 0.5) / width
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


@pytest.mark.parametrize("by", BY)
def test_mirror_ball_sees_a_single_bright_texel_where_it_is(by: str) -> None:
    """A mirror ball at the origin, seen along -x, shows each texel's centre at the normal half-way to it.

    For a texel toward d and a viewer toward o the highlight sits at the normal (o + d) / |o + d|; mirroring the view
    there must fetch this texel of the map and no other.
    """
    height, width = 8, 16
    viewer = np.array([1.0, 0.0, 0.0])
    for row in range(height):
        for column in range(width):
            one_hot = torch.zeros(height, width)
            one_hot[row, column] = 1
            toward = written_convention(row, column, height, width)
            normal = (viewer + toward) / np.linalg.norm(viewer + toward)
            mirrored = 2 * (viewer @ normal) * normal - viewer
            texel = BY[by].direction_to_texel(torch.from_numpy(mirrored), height, width)
            assert one_hot.flatten()[texel] == 1
            centre = texel_centres(height, width)[row, column].numpy()
            np.testing.assert_allclose(centre, toward, atol=1e-6)


# ---------------------------------------------------------------- sampling
def one_bright() -> torch.Tensor:
    radiance = torch.full((16, 32, 3), 0.1)
    radiance[5, 20] = 5000.0
    return radiance


def bright_pole() -> torch.Tensor:
    radiance = torch.full((16, 32, 3), 0.05)
    radiance[0] = 30.0
    return radiance


def bright_seam() -> torch.Tensor:
    """Light on both sides of the azimuth seam, more on one."""
    radiance = torch.full((16, 32, 3), 0.05)
    radiance[7:10, 0], radiance[7:10, -1] = 200.0, 50.0
    return radiance


def random_map() -> torch.Tensor:
    return torch.rand(9, 14, 3, generator=torch.Generator().manual_seed(1)) ** 6


def holes() -> torch.Tensor:
    """A random map with black texels, the first and the last among them."""
    radiance = random_map()
    radiance[torch.rand(9, 14, generator=torch.Generator().manual_seed(2)) < 0.5] = 0
    radiance[0, 0] = radiance[-1, -1] = 0
    return radiance


MAPS: dict[str, Callable[[], torch.Tensor]] = {
    "one bright texel among dark": one_bright,
    "black": lambda: torch.zeros(8, 16, 3),
    "random": random_map,
    "with black texels": holes,
    "bright pole row": bright_pole,
    "bright seam": bright_seam,
    "1 x 2": lambda: torch.tensor([[[1.0, 2.0, 3.0], [0.5, 0.5, 0.5]]]),
    "1 x 1": lambda: torch.ones(1, 1, 3),
    "one channel only": lambda: random_map() * torch.tensor([0.0, 1.0, 0.0]),
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
def test_density_integrates_to_one_for_every_normal(name: str, uniform_fraction: float) -> None:
    radiance = MAPS[name]()
    height, width, _ = radiance.shape
    sampler = LatLongSampler.build(radiance, uniform_fraction=uniform_fraction)
    for normal in bin_centres():
        found = density(sampler, normal)
        assert (found >= 0).all()
        assert (found * solid_angles(height, width)).sum() == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.25])
@pytest.mark.parametrize("name", MAPS)
def test_texels_are_drawn_by_their_density(name: str, uniform_fraction: float) -> None:
    """Chi-square over all texels for five normals, 100 000 draws each; false alarms in chi_square.py."""
    radiance = MAPS[name]()
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
    radiance = MAPS[name]()
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


@pytest.mark.parametrize("height", [1, 2, 16, 32, 64])
def test_every_direction_that_can_light_a_normal_can_be_drawn(height: int) -> None:
    """Wherever n.d > 0 in a lit texel the density is at least a share of what cosine-weighted sampling would give.

    The texel is judged by its centre, the normal by its cell's: both distances must be allowed for.
    """
    sampler = LatLongSampler.build(torch.ones(height, 2 * height, 3))
    rng = torch.Generator().manual_seed(5)
    normal, direction = (
        torch.nn.functional.normalize(torch.randn(200_000, 3, dtype=torch.float64, generator=rng), dim=-1)
        for _ in range(2)
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
    radiance = MAPS[name]()
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


def test_blocks_hold_every_texel_once_and_bound_the_cosine() -> None:
    """On a map whose sides no number of blocks divides."""
    height, width = 37, 71
    grid = sampling_grid(height, width, torch.device("cpu"))
    assert torch.equal(grid.order.sort().values, torch.arange(height * width).int())
    assert torch.equal(grid.block[grid.order], grid.block.sort().values)
    assert torch.equal(grid.end.diff(prepend=torch.zeros(1, dtype=torch.int32)), torch.bincount(grid.block).int())
    rng = torch.Generator().manual_seed(6)
    normal, direction = (
        torch.nn.functional.normalize(torch.randn(200_000, 3, dtype=torch.float64, generator=rng), dim=-1)
        for _ in range(2)
    )
    block = grid.block[latlong.direction_to_texel(direction, height, width)]
    assert (grid.bound[normal_bin(normal), block] >= (normal * direction).sum(-1).float()).all()


def test_sampling_tables_carry_no_gradient() -> None:
    radiance = torch.rand(4, 8, 3, requires_grad=True)
    sampler = LatLongSampler.build(radiance)
    assert not any(table.requires_grad for table in (sampler.entries, sampler.texels, sampler.edges, sampler.brightness))
    assert not any(table.requires_grad for table in (sampler.share, sampler.evenly))


# ---------------------------------------------------------------- resizing
def power(radiance: np.ndarray) -> np.ndarray:
    height, width, _ = radiance.shape
    return (radiance.astype(np.float64) * row_solid_angles(height, width).numpy()[:, None, None]).sum((0, 1))


@pytest.mark.parametrize("height", [1, 2, 8, 16])
def test_resizing_keeps_power(height: int) -> None:
    radiance = np.random.default_rng(0).pareto(1.0, (16, 32, 3)).astype(np.float32)
    small = resize_light(radiance, height)
    assert small.shape == (height, 2 * height, 3)
    np.testing.assert_allclose(power(small), power(radiance), rtol=1e-5)


def test_resizing_averages_where_the_light_is() -> None:
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[12:14, 20:22] = (3.0, 2.0, 1.0)
    small = resize_light(radiance, 8)
    np.testing.assert_allclose(small[6, 10], (3, 2, 1), rtol=1e-6)
    assert np.count_nonzero(small.sum(-1)) == 1


@pytest.mark.parametrize(("shape", "height"), [((16, 32), 5), ((16, 32), 32), ((12, 20), 6), ((1, 1), 1)])
def test_only_whole_reductions(shape: tuple[int, int], height: int) -> None:
    with pytest.raises(ValueError, match="not a whole factor"):
        resize_light(np.ones((*shape, 3), np.float32), height)
