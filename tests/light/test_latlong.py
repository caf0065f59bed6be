"""The lat-long map: its geometry against closed forms written out here.

What the renderer's kernels compute is called as they have it (``kernel_calls``); what torch has too is tested beside it.
"""

import math

import kernel_calls
import numpy as np
import pytest
import torch

from ia_bench.light import latlong
from ia_bench.light.latlong import row_solid_angles, texel_centres

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
def test_the_last_column_of_a_large_map_lies_in_its_row(by: str) -> None:
    """Of which float32 cannot number the texels; z is uniform over the height of a row."""
    height, width = 4096, 8192
    edges, half = torch.cos(torch.linspace(0, math.pi, height + 1, dtype=torch.float64)), torch.full((height,), 0.5)
    direction = BY[by].texel_to_direction(torch.arange(1, height + 1) * width - 1, half, half, height, width)
    torch.testing.assert_close(direction[:, 2].double(), (edges[1:] + edges[:-1]) / 2, rtol=0, atol=1e-6)
    torch.testing.assert_close(direction.norm(dim=-1), torch.ones(height))


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
