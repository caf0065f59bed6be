"""Meshes: of distances that are known, without their detail, and their texture coordinates."""

import numpy as np
import pytest
import torch
import trimesh
import xatlas

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid, mesh_of, smoothed
from ia_bench.geometry.mesh import smooth_normals
from ia_bench.geometry.unwrapping import unwrap
from ia_bench.scenes.scene import Mesh
from tests.shapes import sphere


# ---------------------------------------------------------------- meshes of distances that are known
# Radius, normals, winding, number of triangles, parts.
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


# ---------------------------------------------------------------- heat flow of a sphere
# Which is known: the Laplacian of the position on a sphere is -2 / radius^2 times the position.
@pytest.mark.parametrize("width", [0.05, 0.3])
def test_a_sphere_shrinks_as_the_heat_equation_says(width: float) -> None:
    ball = sphere(4, radius=0.8)
    after = np.linalg.norm(smoothed(ball, width).vertices, axis=1)
    expected = 0.8 / (1 + (width / 0.8) ** 2)  # one implicit step of t = width^2 / 2
    np.testing.assert_allclose(after, expected, rtol=2e-3)


def test_seams_stay_closed_and_texture_coordinates_stay() -> None:
    ball = sphere(2, smooth=False)  # every triangle has corners of its own
    after = smoothed(ball, 0.2)
    np.testing.assert_array_equal(after.uv, ball.uv)
    _, before = np.unique(ball.vertices, axis=0, return_inverse=True)
    for place in range(before.max() + 1):
        assert np.ptp(after.vertices[before.reshape(-1) == place], axis=0).max() == 0
    np.testing.assert_allclose(np.linalg.norm(after.normals, axis=1), 1, atol=1e-5)


# ---------------------------------------------------------------- normals of a mesh that stores none
def test_both_sides_of_a_leaf_keep_their_normals() -> None:
    """Triangles on both sides of a plane, whose corners lie in the same places and whose normals have a mean of nothing."""
    rows, columns = np.indices((5, 5))
    places = np.stack([rows, columns, 0 * rows], -1).reshape(-1, 3) / 4
    first = (rows * 5 + columns)[:-1, :-1].reshape(-1)
    above = np.concatenate([np.stack([first, first + 5, first + 6], 1), np.stack([first, first + 6, first + 1], 1)])
    vertices, faces = np.concatenate([places, places]), np.concatenate([above, above[:, ::-1] + 25])
    expected = np.repeat([[0.0, 0, 1], [0, 0, -1]], 25, axis=0)
    np.testing.assert_allclose(smooth_normals(vertices, faces), expected, atol=1e-12)
    leaf = Mesh(vertices.astype(np.float32), faces, expected.astype(np.float32), np.zeros((50, 2), np.float32))
    np.testing.assert_allclose(smoothed(leaf, 0.1).normals, expected, atol=1e-6)


def test_normals_of_a_tiny_ball_point_away_from_its_middle() -> None:
    """Whatever lies far away and belongs to no triangle."""
    solid = ball(1e-7)
    outward = solid.vertices / np.linalg.norm(solid.vertices, axis=1, keepdims=True)
    found = smooth_normals(np.concatenate([solid.vertices, [[1.0, 0, 0]]]), solid.faces)[:-1]
    assert (found * outward).sum(1).min() > np.cos(np.radians(0.5))


# ---------------------------------------------------------------- texture coordinates by xatlas
# The size of an object decides nothing, and what xatlas cannot do is told.
def ball(scale: float, place: float = 0.0) -> trimesh.Trimesh:
    """A ball of 1280 triangles, of this radius, at this place on the x axis."""
    solid = trimesh.creation.icosphere(3)
    return trimesh.Trimesh(solid.vertices * scale + [place, 0, 0], solid.faces, process=False)


def unwrapped(solid: trimesh.Trimesh) -> Mesh:
    return unwrap(np.asarray(solid.vertices), np.asarray(solid.faces), np.asarray(solid.vertex_normals))


def covered(mesh: Mesh) -> float:
    """The share of the texture that triangles cover, each counted by its own area."""
    a, b, c = (mesh.uv[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    return float(0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum())


@pytest.mark.parametrize("scale", [0.1, 1e-2, 1e-3, 1e-5])
def test_a_small_object_has_the_atlas_of_a_large_one(scale: float) -> None:
    small = unwrapped(ball(scale))
    assert covered(small) == pytest.approx(covered(unwrapped(ball(1.0))), abs=0.02)
    np.testing.assert_allclose(np.linalg.norm(small.vertices, axis=1), scale, rtol=1e-5)  # it stays where it is


@pytest.mark.parametrize("scale", [0.25, 0.5, 3.0])
def test_other_objects_are_given_to_xatlas_as_they_are(scale: float) -> None:
    """From a longest side of .5 on, to the bit: textures of finished runs belong to these coordinates."""
    solid = ball(scale)
    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    atlas.add_mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32), solid.vertex_normals.astype(np.float32))
    options.padding, options.resolution, options.bilinear = 2, 1024, True
    atlas.generate(pack_options=options)
    _, faces, uv = atlas[0]
    mesh = unwrapped(solid)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.uv, uv)


def test_coordinates_that_are_not_finite_are_refused() -> None:
    """Two balls so small beside what is between them that xatlas takes all triangles for none."""
    apart = trimesh.util.concatenate([ball(1e-5), ball(1e-5, place=1.0)])
    with pytest.raises(InputError, match="^xatlas: expected texture coordinates of all triangles, found NaN or Inf"):
        unwrapped(apart)
