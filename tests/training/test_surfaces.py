"""Building blocks and objects: closed, of the right volume, with normals that are those of the smooth surface."""

import math

import numpy as np
import pytest
import trimesh

from ia_bench_training import primitives
from ia_bench_training.objects import MAX_SLOTS, MAX_TRIANGLES, make_object
from ia_bench_training.surfaces import revolve, rounded_box, superquadric, sweep

FAMILIES = sorted({f.__name__: f for f in (*primitives.SOLIDS, *primitives.THIN)}.items())


def volume(surface):
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight
    return mesh.volume


def test_volumes_of_known_solids():
    assert volume(superquadric(1, 1, 128)) == pytest.approx(4 / 3 * math.pi, rel=3e-3)
    half, r = np.array([0.5, 0.7, 0.9]), 0.2
    a, b, c = half - r  # box + slabs on its faces + quarter cylinders on its edges + a ball on its corners
    exact = 8 * a * b * c + 8 * r * (a * b + b * c + a * c) + 2 * math.pi * r * r * (a + b + c) + 4 / 3 * math.pi * r**3
    assert volume(rounded_box(half, r, 16)) == pytest.approx(exact, rel=2e-3)
    assert volume(revolve(np.array([[0, -1], [0.5, -1], [0.5, 1], [0, 1]]), 400)) == pytest.approx(math.pi * 0.5, rel=1e-3)
    t = np.arange(400) * math.pi / 200
    ring = sweep(np.stack([np.cos(t), np.sin(t), 0 * t], -1), primitives.circle(100, 0.2), closed=True)
    assert abs(volume(ring)) == pytest.approx(2 * math.pi**2 * 0.04, rel=2e-3)


@pytest.mark.parametrize(("name", "family"), FAMILIES)
def test_every_family_is_closed_and_finite(name, family):
    for seed in range(4):
        surface = family(np.random.default_rng(seed))
        assert np.isfinite(surface.vertices).all()
        assert 4 <= len(surface.faces) <= MAX_TRIANGLES
        edges = np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, counts = np.unique(edges, axis=0, return_counts=True)
        assert (counts % 2 == 0).all(), f"{name}, seed {seed}: {np.count_nonzero(counts % 2)} open edges"


def test_objects_fit_the_unit_ball_and_differ():
    faces = set()
    for seed in range(25):
        solid = make_object(np.random.default_rng(seed))
        faces.add(len(solid.faces))
        assert np.linalg.norm(solid.vertices, axis=1).max() == pytest.approx(1, abs=1e-5)
        assert len(solid.faces) <= MAX_TRIANGLES
        assert 0 <= solid.slot.min() <= solid.slot.max() < solid.slots <= MAX_SLOTS
        lengths = np.linalg.norm(solid.normals, axis=-1)
        assert (np.abs(lengths - 1) < 1e-3).mean() > 0.999
    assert len(faces) > 20
