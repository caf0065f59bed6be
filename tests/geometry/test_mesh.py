"""The mesh reader: what it repairs and says, what it refuses; on copies of the mesh of `tiny` broken in one place."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ia_bench.common.errors import InputError
from ia_bench.geometry import mesh as mesh_module
from ia_bench.geometry.mesh import load_mesh
from ia_bench.scenes.scene import Mesh, Scene


@dataclass
class Ply:
    """What goes into a file: (V, 3) vertices, (F, 3) faces, optional (V, 3) normals and (V, 2) UV."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None

    def write(self, path: Path) -> Path:
        columns, names = [self.vertices], ["x", "y", "z"]
        for values, more in ((self.normals, ["nx", "ny", "nz"]), (self.uv, ["u", "v"])):
            if values is not None:
                columns.append(values)
                names += more
        header = ["ply", "format ascii 1.0", f"element vertex {len(self.vertices)}"]
        header += [f"property float {name}" for name in names]
        header += [f"element face {len(self.faces)}", "property list uchar int vertex_indices", "end_header"]
        rows = [" ".join(f"{value:.9g}" for value in row) for row in np.concatenate(columns, axis=1)]
        rows += [" ".join(map(str, (len(face), *face))) for face in self.faces]
        path.write_text("\n".join([*header, *rows]) + "\n")
        return path


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def ply(tiny: Scene) -> Ply:
    mesh = tiny.mesh
    return Ply(mesh.vertices.copy(), mesh.faces.copy(), mesh.normals.copy(), mesh.uv.copy())


def corners(mesh: Mesh) -> np.ndarray:
    """Corner positions of all triangles in an order of their own, so that two meshes can be compared as sets."""
    triangles = mesh.vertices[mesh.faces].reshape(len(mesh.faces), 9)
    return triangles[np.lexsort(triangles.T)]


def refused(path: Path, message: str, *, uv: str = "mesh") -> None:
    with pytest.raises(InputError, match=rf"mesh\.ply: .*{message}"):
        load_mesh(path, uv=uv)


def test_a_sound_mesh_is_read_as_it_is(tmp_path: Path, ply: Ply, tiny: Scene) -> None:
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert notes == ()
    for name in ("vertices", "faces", "normals", "uv"):
        np.testing.assert_allclose(getattr(mesh, name), getattr(tiny.mesh, name), atol=1e-6)


def test_refuses_what_is_no_mesh(tmp_path: Path) -> None:
    refused(tmp_path / "mesh.ply", "no such mesh")
    (tmp_path / "mesh.ply").write_text("solid nothing")
    refused(tmp_path / "mesh.ply", "not a readable mesh")


def test_refuses_a_mesh_without_triangles(tmp_path: Path, ply: Ply) -> None:
    ply.faces = ply.faces[:0]
    refused(ply.write(tmp_path / "mesh.ply"), "expected triangles, found none")


QUAD = "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))


def test_an_obj_counts_from_one(tmp_path: Path) -> None:
    """Vertex 0 is nobody's, and negative ones count from the end."""
    path = tmp_path / "mesh.obj"
    path.write_text(QUAD + "f 1/1 2/2 3/3\nf -4/-4 -2/-2 -1/-1\n")
    assert len(load_mesh(path)[0].faces) == 2
    path.write_text(QUAD + "f 1/1 2/2 3/3\nf 0/1 3/3 4/4\n")
    with pytest.raises(InputError, match=r"mesh\.obj: expected faces of vertices that are counted from 1, found vertex 0"):
        load_mesh(path)


def test_a_pipe_in_place_of_materials_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mtl")
    (tmp_path / "mesh.obj").write_text(f"mtllib pipe.mtl\n{QUAD}usemtl it\nf 1/1 2/2 3/3\n")
    try:
        assert len(load_mesh(tmp_path / "mesh.obj")[0].faces) == 1
    except InputError as error:
        assert "pipe.mtl: expected a file" in str(error)  # noqa: PT017 (either is right)


@pytest.mark.parametrize("uv", ["mesh", "xatlas"])
def test_refuses_triangles_in_each_other_s_way(tmp_path: Path, uv: str) -> None:
    vertices = np.random.default_rng(0).uniform(-1, 1, (6000, 3))
    path = Ply(vertices, np.arange(6000).reshape(-1, 3), None, np.zeros((6000, 2))).write(tmp_path / "mesh.ply")
    refused(path, "expected the triangles of a surface, found 2000 that lie in each other's way: a ray would meet", uv=uv)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("uv", ["mesh", "xatlas"])
def test_refuses_vertices_that_are_not_finite(tmp_path: Path, ply: Ply, bad: float, uv: str) -> None:
    ply.vertices[[3, 5], 1] = bad
    refused(ply.write(tmp_path / "mesh.ply"), f"2 of {len(ply.vertices)} vertices are NaN or Inf", uv=uv)


def test_refuses_a_face_of_a_vertex_that_is_not_there(tmp_path: Path, ply: Ply) -> None:
    ply.faces[7, 1] = len(ply.vertices)
    refused(ply.write(tmp_path / "mesh.ply"), f"not a readable mesh.* {len(ply.vertices)} ")
    ply.faces[7, 1] = -1
    refused(ply.write(tmp_path / "mesh.ply"), f"expected faces of vertices 0 to {len(ply.vertices) - 1}, found -1 to")


def test_drops_triangles_of_zero_area_and_says_so(tmp_path: Path, ply: Ply) -> None:
    sound = len(ply.faces)
    a, b = ply.faces[0, :2]
    middle = 0.5 * (ply.vertices[a] + ply.vertices[b])
    ply.vertices = np.vstack([ply.vertices, middle])
    ply.normals, ply.uv = np.vstack([ply.normals, ply.normals[a]]), np.vstack([ply.uv, ply.uv[a]])
    slivers = [(a, a, b), (a, b, len(ply.vertices) - 1)]  # a repeated corner; three corners on a line
    ply.faces = np.vstack([ply.faces, slivers])
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert any(f"dropped 2 zero-area triangles of {sound + 2}" in note for note in notes)
    assert len(mesh.faces) == sound


def test_a_small_scene_has_no_zero_areas(tmp_path: Path, ply: Ply) -> None:
    ply.vertices = ply.vertices * 1e-4
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert notes == ()
    assert len(mesh.faces) == len(ply.faces)


def test_refuses_a_mesh_of_nothing_but_zero_areas(tmp_path: Path, ply: Ply) -> None:
    ply.vertices[:] = ply.vertices[:1]
    refused(ply.write(tmp_path / "mesh.ply"), f"every one of the {len(ply.faces)} triangles has zero area")


@pytest.mark.parametrize("uv", ["mesh", "xatlas"])
def test_drops_unreferenced_vertices_and_says_so(tmp_path: Path, ply: Ply, tiny: Scene, uv: str) -> None:
    stray = np.array([[9.0, 9.0, 9.0], [8.0, 8.0, 8.0]])
    ply.vertices = np.vstack([stray, ply.vertices])  # in front, so that every index must move
    ply.normals, ply.uv = np.vstack([stray, ply.normals]), np.vstack([stray[:, :2], ply.uv])  # their UV do not count
    ply.faces = ply.faces + 2
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"), uv=uv)
    made = ("mesh.ply: UV made by xatlas",) if uv == "xatlas" else ()
    assert notes == (f"mesh.ply: dropped 2 unreferenced vertices of {len(ply.vertices)}", *made)  # normals are kept
    np.testing.assert_allclose(corners(mesh), corners(tiny.mesh), atol=1e-6)
    assert mesh.vertices.max() < 2


@pytest.mark.parametrize(("value", "found"), [(1.5, r"1\.5"), (-0.25, r"-0\.25"), (np.nan, "nan")])
def test_uv_outside_the_unit_square(tmp_path: Path, ply: Ply, value: float, found: str) -> None:
    ply.uv[11, 0] = value
    path = ply.write(tmp_path / "mesh.ply")
    refused(path, rf"expected UV within \[0, 1\], found .*{found}.*reader\.options\.uv=xatlas")
    mesh, notes = load_mesh(path, uv="xatlas")
    assert notes == ("mesh.ply: UV made by xatlas",)
    assert 0 <= mesh.uv.min() < mesh.uv.max() <= 1


def uv_areas(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.uv[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    return 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_a_mesh_without_uv_is_refused_or_unwrapped(tmp_path: Path, ply: Ply, tiny: Scene) -> None:
    """What xatlas makes covers a fair part of the square, overlaps nowhere, and leaves the surface where it was."""
    ply.uv = None
    path = ply.write(tmp_path / "mesh.ply")
    refused(path, "no UV.*reader.options.uv=xatlas")
    mesh, notes = load_mesh(path, uv="xatlas")
    assert notes == ("mesh.ply: UV made by xatlas",)
    np.testing.assert_allclose(corners(mesh), corners(tiny.mesh), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    assert 0 <= mesh.uv.min() < mesh.uv.max() <= 1
    areas = uv_areas(mesh)
    assert 0.3 < areas.sum() <= 1
    # Overlap, by counting: random points of the square lie in as many triangles as the areas say, and in one at most.
    points = np.random.default_rng(0).random((400, 2))
    a, b, c = (mesh.uv[mesh.faces[:, i]].astype(np.float64)[None] for i in range(3))

    def side(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (q - p)[..., 0] * (points[:, None] - p)[..., 1] - (q - p)[..., 1] * (points[:, None] - p)[..., 0]

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    inside = ((sides > 0).all(0) | (sides < 0).all(0)).sum(1)
    assert inside.max() == 1
    assert abs(inside.mean() - areas.sum()) < 5 * np.sqrt(0.25 / 400)


def test_missing_normals_are_smoothed_across_uv_seams(tmp_path: Path) -> None:
    """A sphere cut open along a meridian: both copies of a seam vertex get the radial direction."""
    rows, columns = 24, 48
    theta, phi = np.meshgrid(np.linspace(0.05, np.pi - 0.05, rows), np.linspace(0, 2 * np.pi, columns), indexing="ij")
    vertices = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    vertices = vertices.round(6)  # so that both copies are the same number
    uv = np.stack([phi / (2 * np.pi), 1 - theta / np.pi], -1).reshape(-1, 2)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    lower = np.stack([corner, corner + columns, corner + columns + 1], 1)
    upper = np.stack([corner, corner + columns + 1, corner + 1], 1)
    path = Ply(vertices, np.concatenate([lower, upper]), None, uv).write(tmp_path / "mesh.ply")
    mesh, notes = load_mesh(path)
    assert notes == ("mesh.ply: no normals stored; smooth normals computed",)
    inner = np.abs(mesh.vertices[:, 2]) < 0.95  # the rims of the two holes have triangles on one side only
    cosine = (mesh.normals * mesh.vertices).sum(1)[inner]
    assert cosine.min() > np.cos(np.radians(2))
    seam = [mesh.normals[np.isclose(mesh.uv[:, 0], u)] for u in (0, 1)]
    np.testing.assert_allclose(*seam, atol=1e-6)


@pytest.mark.parametrize("bad", [0.0, np.nan])
def test_useless_normals_are_computed_again(tmp_path: Path, ply: Ply, tiny: Scene, bad: float) -> None:
    ply.normals[4] = bad
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert notes == ("mesh.ply: stored normals are zero or not finite in places; smooth normals computed instead",)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_a_mesh_of_two_parts_is_joined(tmp_path: Path) -> None:
    obj = """
o one
v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt .4 0\nvt 0 .4\nf 1/1 2/2 3/3
o two
v 0 0 1\nv 1 0 1\nv 0 1 1\nvt .5 .5\nvt .9 .5\nvt .5 .9\nf 4/4 5/5 6/6
"""
    (tmp_path / "mesh.obj").write_text(obj)
    mesh, _ = load_mesh(tmp_path / "mesh.obj")
    assert len(mesh.faces) == 2
    heights = mesh.vertices[mesh.faces][..., 2].mean(1)
    assert sorted(heights) == [0, 1]
    assert mesh.uv[mesh.faces[heights == 1]].min() == pytest.approx(0.5)


def test_a_vertex_with_two_uv_is_split(tmp_path: Path) -> None:
    """OBJ names UV per corner: two triangles of one square on two islands share positions but no UV."""
    obj = """
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1
vt 0 0\nvt .4 0\nvt .4 .4\nvt .5 .5\nvt .9 .9\nvt .5 .9
f 1/1/1 2/2/1 3/3/1\nf 1/4/1 3/5/1 4/6/1
"""
    (tmp_path / "mesh.obj").write_text(obj)
    mesh, notes = load_mesh(tmp_path / "mesh.obj")
    assert notes == ()  # normals are the file's
    expected = {
        (0, 0): [(0, 0), (0.5, 0.5)],
        (1, 1): [(0.4, 0.4), (0.9, 0.9)],
        (1, 0): [(0.4, 0)],
        (0, 1): [(0.5, 0.9)],
    }
    for position, uvs in expected.items():
        here = (mesh.vertices[:, :2] == position).all(1)
        np.testing.assert_allclose(sorted(map(tuple, mesh.uv[here])), uvs, atol=1e-6)


def test_ply_with_uv_per_corner(tmp_path: Path) -> None:
    """The other way to write UV into a PLY: a list of six numbers in each face."""
    ply = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
property list uchar float texcoord
end_header
0 0 0
1 0 0
1 1 0
0 1 0
3 0 1 2 6 0 0 .4 0 .4 .4
3 0 2 3 6 .5 .5 .9 .9 .5 .9
"""
    (tmp_path / "mesh.ply").write_text(ply)
    mesh, _ = load_mesh(tmp_path / "mesh.ply")
    corner = mesh.uv[mesh.faces].reshape(2, 6)
    np.testing.assert_allclose(corner[corner[:, 0].argsort()], [[0, 0, 0.4, 0, 0.4, 0.4], [0.5, 0.5, 0.9, 0.9, 0.5, 0.9]])


def test_a_mesh_is_kept_for_the_next_time(tmp_path: Path, ply: Ply, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its notes, without a reader; another file of that name, or other texture coordinates, is read again."""
    ply.normals = None
    path = ply.write(tmp_path / "mesh.ply")
    mesh, notes = load_mesh(path)
    assert notes
    with monkeypatch.context() as patch:
        patch.setattr(mesh_module, "_read", None)
        again, the_same = load_mesh(path)
        assert the_same == notes
        for name in ("vertices", "faces", "normals", "uv"):
            kept, made = getattr(again, name), getattr(mesh, name)
            assert kept.dtype == made.dtype
            np.testing.assert_array_equal(kept, made)
    unwrapped, _ = load_mesh(path, uv="xatlas")
    assert not np.array_equal(unwrapped.uv, mesh.uv)
    ply.vertices *= 2
    larger, _ = load_mesh(ply.write(path))
    np.testing.assert_allclose(np.ptp(larger.vertices, axis=0), 2 * np.ptp(mesh.vertices, axis=0), rtol=1e-6)
