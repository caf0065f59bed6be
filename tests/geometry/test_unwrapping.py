"""Texture coordinates by xatlas: the size of an object decides nothing, and what xatlas cannot do is told."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import xatlas

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import unwrap
from ia_bench.scenes.scene import Mesh


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
    atlas.add_mesh(
        solid.vertices.astype(np.float32), solid.faces.astype(np.uint32), solid.vertex_normals.astype(np.float32)
    )
    options.padding, options.resolution, options.bilinear = 2, 1024, True
    atlas.generate(pack_options=options)
    _, faces, uv = atlas[0]
    mesh = unwrapped(solid)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.uv, uv)


def test_coordinates_that_are_not_finite_are_refused() -> None:
    """Two balls so small beside what is between them that xatlas takes all triangles for none."""
    apart = trimesh.util.concatenate([ball(1e-5), ball(1e-5, place=1.0)])
    with pytest.raises(InputError, match=r"^xatlas: expected finite texture coordinates, found NaN or Inf at \d+ of \d+ vertices"):
        unwrapped(apart)
