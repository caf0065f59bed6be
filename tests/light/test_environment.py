"""An environment against its own texels, and its maps at other heights against what they must keep: power and place."""

import numpy as np
import pytest
import torch

from ia_bench.light.environment import LatLongEnvironment, turned
from ia_bench.light.latlong import row_solid_angles, texel_centres


def random_map(height: int = 6, width: int = 12) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).pareto(1.0, (height, width, 3))).float()


def power(texels: torch.Tensor) -> torch.Tensor:
    rows = row_solid_angles(*texels.shape[:2])
    return (texels.double() * rows[:, None, None]).sum((0, 1))


@pytest.mark.parametrize("height", [1, 2, 5, 7, 33])
@pytest.mark.parametrize("shape", [(6, 12), (5, 7)])
def test_any_height_keeps_power(height: int, shape: tuple[int, int]) -> None:
    texels = random_map(*shape)
    resized = LatLongEnvironment(texels).latlong(height)
    assert resized.shape == (height, 2 * height, 3)
    torch.testing.assert_close(power(resized), power(texels), rtol=1e-6, atol=0)


def test_whole_factors_average_and_repeat() -> None:
    texels = random_map(8, 16)
    light = LatLongEnvironment(texels)
    weight = np.broadcast_to(row_solid_angles(8, 16).numpy()[:, None, None], (8, 16, 3))
    blocks = [(values.reshape(4, 2, 8, 2, 3)).sum((1, 3)) for values in (texels.numpy() * weight, weight)]
    torch.testing.assert_close(light.latlong(4), torch.from_numpy(blocks[0] / blocks[1]).float())
    torch.testing.assert_close(light.latlong(24), texels.repeat_interleave(3, 0).repeat_interleave(3, 1))


@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_a_map_is_turned_and_mirrored_about_the_vertical_axis(axes: tuple[int, int], signs: tuple[int, int]) -> None:
    """Quarter turns and reflections take the centres of texels to one another."""
    radiance, matrix = random_map(8, 16).numpy(), np.zeros((3, 3))
    matrix[axes, (0, 1)], matrix[2, 2] = signs, 1
    centres = texel_centres(8, 16).reshape(-1, 3).double()
    expected = LatLongEnvironment(torch.from_numpy(radiance)).radiance(centres.float() @ torch.from_numpy(matrix).float())
    np.testing.assert_allclose(turned(radiance, matrix).reshape(-1, 3), expected, rtol=1e-4, atol=1e-2)
