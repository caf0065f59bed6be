"""Meshes of distances that are known: radius, normals, winding, number of triangles, parts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.surface import extracted, mesh_of


def field(*balls: tuple[tuple[float, float, float], float], cells: int = 40) -> DistanceGrid:
    """Exact distances to the union of balls, (centre, radius), in the box from -1 to 1."""
    grid = DistanceGrid(torch.zeros(cells + 1, cells + 1, cells + 1), torch.full((3,), -1.0), 2 / cells)
    distances = [(grid.positions() - torch.tensor(centre)).norm(dim=-1) - radius for centre, radius in balls]
    grid.values.copy_(torch.stack(distances).amin(0))
    return grid


def test_interpolation_and_refinement_of_distances() -> None:
    grid = field(((0.1, 0.0, -0.2), 0.6))
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) * 1.8 - 0.9
    true = (points - torch.tensor([0.1, 0.0, -0.2])).norm(dim=-1) - 0.6
    away = (true + 0.6) > 0.2  # from the centre, where distances have a kink
    assert (grid.at(points) - true)[away].abs().max() < 0.2 * grid.step
    fine = grid.refined()
    assert fine.step == pytest.approx(0.5 * grid.step)
    torch.testing.assert_close(fine.high, grid.high)
    torch.testing.assert_close(fine.values[::2, ::2, ::2], grid.values)


def test_the_mesh_of_a_ball() -> None:
    mesh = mesh_of(field(((0.1, 0.0, -0.2), 0.6)), 1500)
    outward = mesh.vertices - np.array([0.1, 0.0, -0.2])
    radius = np.linalg.norm(outward, axis=1)
    assert 1000 < len(mesh.faces) <= 1500
    assert np.abs(radius - 0.6).max() < 0.01
    assert ((mesh.normals * outward).sum(1) / radius).min() > 0.999
    corners = mesh.vertices[mesh.faces]
    wound = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((wound * (corners.mean(1) - np.array([0.1, 0.0, -0.2]))).sum(1) > 0).all()
    assert 0 <= mesh.uv.min() < mesh.uv.max() <= 1


def test_crumbs_go_and_parts_stay() -> None:
    vertices, _ = extracted(field(((-0.4, 0.0, 0.0), 0.4), ((0.5, 0.0, 0.0), 0.3), ((0.0, 0.9, 0.0), 0.03)))
    assert vertices[:, 0].min() < -0.7
    assert vertices[:, 0].max() > 0.7
    assert vertices[:, 1].max() < 0.5


def test_distances_without_a_surface_are_refused() -> None:
    with pytest.raises(InputError, match="some below and some above 0"):
        extracted(field(((0.0, 0.0, 0.0), 5.0)))
