"""Both ray tracers against Moeller and Trumbore's test of every ray with every triangle, in float64."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from shapes import disk, mesh_of, plate, soup, sphere, together

from ia_bench.render.rays import EmbreeRays, RayCaster, WarpRays
from ia_bench.render.rays import _library as embree_library
from ia_bench.scenes.scene import Mesh

CPU = torch.device("cpu")
TRACERS = ("embree", "warp")


def tracer(name: str, mesh: Mesh) -> RayCaster:
    return EmbreeRays(mesh) if name == "embree" else WarpRays(mesh, CPU)


def brute_force(mesh: Mesh, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, ...]:
    """Nearest face, barycentrics of corners 1 and 2, distance, and how near an edge the decision was, per ray."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    first, second = b - a, c - a
    cross = np.cross(directions[:, None], second)
    determinant = (cross * first).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origins[:, None] - a
        u = (offset * cross).sum(-1) / determinant
        turned = np.cross(offset, first)
        v = (directions[:, None] * turned).sum(-1) / determinant
        distance = (second * turned).sum(-1) / determinant
        margin = np.minimum(np.minimum(u, v), 1 - u - v)  # >= 0 inside
    hit = (margin >= 0) & (distance > 0)
    nearest = np.where(hit, distance, np.inf)
    face = nearest.argmin(1)
    every = np.arange(len(origins))
    missed = ~hit.any(1)
    doubtful = ((np.abs(margin) < 1e-4) & (distance > 0)).any(1)
    uv = np.stack([u[every, face], v[every, face]], -1)
    return np.where(missed, -1, face), uv, nearest[every, face], doubtful


def rays_through(seed: int, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Random rays that start in and around [-1, 1]^3, float32 values in float64."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-1.5, 1.5, (count, 3)).astype(np.float32).astype(np.float64), directions.astype(np.float32).astype(
        np.float64
    )


MESHES = {
    "random triangles": soup(60, 3),
    "one triangle": mesh_of(np.eye(3), [(0, 1, 2)]),
    "sphere": sphere(1),
    "disk over a plate": together(plate(1.0), disk(0.5, height=0.5, segments=16)),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("kind", TRACERS)
def test_nearest_hits_and_whether_there_is_one(kind: str, name: str) -> None:
    mesh = MESHES[name]
    origins, directions = rays_through(1)
    face, uv, distance, doubtful = brute_force(mesh, origins, directions)
    assert doubtful.mean() < 0.02  # rays within 1e-4 of an edge may go either way
    assert (face >= 0).mean() > 0.02
    assert (face < 0).mean() > 0.02
    rays = tracer(kind, mesh)
    asked = [torch.from_numpy(a).float() for a in (origins, directions)]
    found, blocked = rays.intersect(*asked), rays.occluded(*asked)
    clear = ~doubtful
    np.testing.assert_array_equal(found[0].numpy()[clear], face[clear])
    hit = clear & (face >= 0)
    np.testing.assert_allclose(found[1].numpy()[hit], uv[hit], atol=2e-4)
    np.testing.assert_allclose(found[2].numpy()[hit], distance[hit], rtol=1e-3, atol=1e-4)
    assert np.isinf(found[2].numpy()[clear & (face < 0)]).all()
    np.testing.assert_array_equal(blocked.numpy()[clear], face[clear] >= 0)
    assert (found[0].dtype, blocked.dtype) == (torch.int64, torch.bool)
    assert rays.rays == 2 * len(origins)


@pytest.mark.skipif("avx512f" not in Path("/proc/cpuinfo").read_text(), reason="no AVX-512 here to be left out")
@pytest.mark.parametrize("elevation", [90.0, 30.0, 1.0, 0.2])
def test_hits_are_those_of_every_processor(elevation: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit: Embree divides by approximations that differ between instruction sets (and makers), so it may only say which
    triangles a ray meets. Of a plate and its back, which coincide, either would be the nearest by its rounding, the more so in
    directions that graze them by a few degrees of ``elevation``."""
    plate_and_soup = together(plate(1.0), soup(60, 3))
    mesh = mesh_of(plate_and_soup.vertices, [*plate_and_soup.faces.tolist(), *plate_and_soup.faces[:, ::-1].tolist()])
    turned = Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix().T
    mesh = mesh_of(mesh.vertices @ turned, mesh.faces)
    rng, height = np.random.default_rng(5), np.radians(elevation)
    around = rng.uniform(0, 2 * np.pi, 20_000)
    toward = np.stack([np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.full(20_000, -np.sin(height))], -1)
    start = np.stack([*rng.uniform(-0.9, 0.9, (2, 20_000)), np.zeros(20_000)], -1) - rng.uniform(0.5, 2, (20_000, 1)) * toward
    origins, directions = (torch.from_numpy(a @ turned).float() for a in (start, toward))
    library = embree_library()[0]
    found = EmbreeRays(mesh).intersect(origins, directions)
    assert (found[0] >= 0).double().mean() > 0.5
    monkeypatch.setattr("ia_bench.render.rays._library", lambda: (library, library.rtcNewDevice(b"isa=avx2")))
    for values, others in zip(found, EmbreeRays(mesh).intersect(origins, directions), strict=True):
        assert torch.equal(values, others)
    exact_face, exact_uv, exact_distance, doubtful = brute_force(mesh, origins.double().numpy(), directions.double().numpy())
    clear = ~doubtful & (exact_face >= 0) & (exact_face == found[0].numpy())
    assert clear.any()
    np.testing.assert_allclose(found[1].numpy()[clear], exact_uv[clear], atol=1e-7)
    np.testing.assert_allclose(found[2].numpy()[clear], exact_distance[clear], rtol=2e-7)


# ---------------------------------------------------------------- packets
COUNTS = (0, 1, 16, 17, 127, 129, 1000)  # about the sizes of Embree's packets and of a kernel's item


@pytest.fixture(scope="module")
def many() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Origins and directions of rays through random triangles, clear of edges; their faces, and whether they hit one."""
    origins, directions = rays_through(3, 4000)
    face, _, _, doubtful = brute_force(MESHES["random triangles"], origins, directions)
    rays = (torch.from_numpy(a[~doubtful]).float() for a in (origins, directions))
    face = torch.from_numpy(face[~doubtful])
    return *rays, face, face >= 0


@pytest.mark.parametrize("kind", TRACERS)
@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("count", COUNTS)
def test_only_what_is_asked_for_is_traced(kind: str, count: int, share: float, many: tuple[torch.Tensor, ...]) -> None:
    rays = tracer(kind, MESHES["random triangles"])
    origins, directions, _, hit = (values[:count] for values in many)
    asked = torch.rand(count, generator=torch.Generator().manual_seed(count)) < share
    assert torch.equal(rays.occluded(origins, directions, asked), hit & asked)
    assert rays.rays == int(asked.sum())


@pytest.mark.parametrize("kind", TRACERS)
@pytest.mark.parametrize(("points", "each"), [(0, 4), (1, 1), (7, 1), (50, 3), (33, 16), (9, 130)])
def test_several_directions_from_every_origin(kind: str, points: int, each: int) -> None:
    """Against the same rays one from each origin, with a mask and without, and with directions that are no memory of their own."""
    rays = tracer(kind, MESHES["sphere"])
    generator = torch.Generator().manual_seed(points * each)
    origins = 1.5 * torch.randn(points, 3, generator=generator)
    directions = torch.nn.functional.normalize(torch.randn(points, each, 3, generator=generator), dim=-1)
    repeated = origins[:, None].expand(-1, each, -1).reshape(-1, 3)
    flat = rays.occluded(repeated, directions.reshape(-1, 3)).reshape(points, each)
    assert torch.equal(rays.occluded(origins, directions), flat)
    asked = torch.rand(points, each, generator=generator) < 0.4
    assert torch.equal(rays.occluded(origins, directions, asked), flat & asked)
    back = torch.cat([directions, directions], 1)[:, each:]
    assert torch.equal(rays.occluded(origins, back, torch.cat([asked, asked], 1)[:, :each]), flat & asked)
    assert points == 0 or each < 16 or (flat.any() and not flat.all())
