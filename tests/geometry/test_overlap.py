"""The share of a texture that several triangles cover, against areas by hand, and what a reader of meshes says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.visual import TextureVisuals

from ia_bench.geometry.mesh import SIDE, load_mesh, shared_texture
from ia_bench.scenes.scene import Scene


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))


def squares(*places: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """UV and faces of squares, each of two triangles; a place is the lower corner and the side, every second is mirrored."""
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    uv = [np.array([x, y]) + side * (corners[::-1] if n % 2 else corners) for n, (x, y, side) in enumerate(places)]
    faces = [4 * n + np.array([[0, 1, 2], [0, 2, 3]]) for n in range(len(places))]
    return np.concatenate(uv), np.concatenate(faces)


@pytest.mark.parametrize(
    ("places", "share"),
    [
        ([(0.1, 0.2, 0.3)], 0.0),
        ([(0.0, 0.0, 1.0)], 0.0),  # the whole texture, to its border
        ([(0.0, 0.0, 0.5), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5)], 0.0),  # side by side
        ([(0.1, 0.2, 0.3), (0.1, 0.2, 0.3)], 1.0),  # stacked
        ([(0.1, 0.1, 0.4), (0.3, 0.3, 0.4)], 1 / 7),  # a quarter of each
        ([(0.1, 0.1, 0.8), (0.3, 0.3, 0.2), (0.3, 0.3, 0.2)], 1 / 16),  # three layers count once
    ],
)
def test_shares_by_hand(places: list[tuple[float, float, float]], share: float) -> None:
    assert shared_texture(*squares(*places)) == pytest.approx(share, abs=4 / SIDE)


def test_random_triangles_agree_with_counting_points() -> None:
    """Points of the square, drawn at random, in triangles by their barycentric coordinates."""
    random = np.random.default_rng(0)
    uv = random.random((30, 2))
    points = random.random((20000, 2))
    faces = np.arange(30).reshape(10, 3)
    inside = np.zeros((10, len(points)), bool)
    for n, (a, b, c) in enumerate(uv[faces]):
        weights = np.linalg.solve(np.stack([b - a, c - a], 1), (points - a).T)
        inside[n] = (weights > 0).all(0) & (weights.sum(0) < 1)
    layers = inside.sum(0)
    expected = (layers > 1).sum() / (layers > 0).sum()
    assert 0.2 < expected < 0.9
    assert shared_texture(uv, faces) == pytest.approx(expected, abs=5 * np.sqrt(0.25 / (layers > 0).sum()))


def test_no_area_shares_nothing() -> None:
    assert shared_texture(np.full((3, 2), 0.5), np.array([[0, 1, 2]])) == 0


def test_a_folded_atlas_is_told_of(tmp_path: Path, tiny: Scene) -> None:
    """The atlas of ``tiny`` folded along its middle; as it is, and made anew, nothing is said of it."""
    mesh = tiny.expect_mesh()
    folded = np.stack([np.abs(2 * mesh.uv[:, 0] - 1), mesh.uv[:, 1]], 1)
    notes = {}
    for name, uv in (("folded", folded), ("plain", mesh.uv)):
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, visual=TextureVisuals(uv=uv), process=False)
        solid.export(tmp_path / f"{name}.obj", include_normals=True)
        notes[name] = load_mesh(tmp_path / f"{name}.obj")[1]
    assert notes["plain"] == ()
    (told,) = notes["folded"]
    assert told.startswith("warning: folded.obj: ")
    assert "reader.options.uv=xatlas makes other coordinates" in told
    assert load_mesh(tmp_path / "folded.obj", uv="xatlas")[1] == ("folded.obj: UV made by xatlas",)
