"""The mesh reader: what it repairs and says, what it refuses; on copies of the mesh of `tiny` broken in one place."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import load_mesh
from ia_bench.render.asset_files import read_asset
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


def test_a_sound_mesh_is_read_as_it_is_and_what_is_none_refused(tmp_path: Path, ply: Ply, tiny: Scene) -> None:
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert notes == ()
    for name in ("vertices", "faces", "normals", "uv"):
        np.testing.assert_allclose(getattr(mesh, name), getattr(tiny.mesh, name), atol=1e-6)
    refused(tmp_path / "no" / "mesh.ply", "no such mesh")
    (tmp_path / "mesh.ply").write_text("solid nothing")
    refused(tmp_path / "mesh.ply", "not a readable mesh")


QUAD = "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))


def test_an_obj_counts_from_one(tmp_path: Path) -> None:
    """Vertex 0 is nobody's, and negative ones count from the end."""
    path = tmp_path / "mesh.obj"
    path.write_text(QUAD + "f 1/1 2/2 3/3\nf -4/-4 -2/-2 -1/-1\n")
    assert len(load_mesh(path)[0].faces) == 2
    for corners in ("0/1 3/3 4/4", "1/0 3/3 4/4"):
        path.write_text(QUAD + f"f 1/1 2/2 3/3\nf {corners}\n")
        with pytest.raises(InputError, match=r"mesh\.obj: expected faces of vertices that are counted from 1, found vertex 0"):
            load_mesh(path)
    path.write_text(2 * (QUAD + "f -4/-4 -3/-3 -2/-2\n"))
    with pytest.raises(InputError, match=r"mesh\.obj: expected faces that count vertices backwards after all vertices, found"):
        load_mesh(path)
    path.write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(
        InputError, match=r"mesh\.obj: expected vertices and faces of three numbers each, found \(3, 2\) and \(1, 3\)"
    ):
        load_mesh(path)


ODD_LINES = {
    "tabs": lambda text: text.replace("f ", "f\t").replace("v ", "v\t").replace("vt ", "vt \t"),
    "one tab": lambda text: text.replace("f 1/1 3", "f\t1/1 3"),
    "indented": lambda text: text.replace("f 1/1 3", "  f 1/1 3"),
    "comments behind": lambda text: re.sub("^(.*)$", r"\1 # f 1/1 2/2 4/4", text, flags=re.MULTILINE),
    "a comment that ends with a backslash": lambda text: "# C:\\models\\\n" + text,
    "a line that goes on": lambda text: text.replace("2/2 3/3", "2/2\\\n3/3"),
    "line ends": lambda text: text.replace("\n", "\r"),
    "byte order mark": lambda text: "\ufeff" + text,
}


@pytest.mark.parametrize("case", ODD_LINES)
def test_lines_of_an_obj_are_read_however_they_are_written(tmp_path: Path, case: str) -> None:
    """trimesh alone leaves out faces, vertices, or all."""
    text = QUAD + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    for name, content in (("plain.obj", text), ("mesh.obj", ODD_LINES[case](text))):
        (tmp_path / name).write_text(content, newline="")
    plain, mesh = (load_mesh(tmp_path / name)[0] for name in ("plain.obj", "mesh.obj"))
    assert len(plain.faces) == 2
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], plain.vertices[plain.faces])
    np.testing.assert_array_equal(mesh.uv[mesh.faces], plain.uv[plain.faces])


def test_texture_coordinates_and_normals_are_not_taken_for_each_other(tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text(QUAD + 4 * "vn 0 0 1\n" + "f 1/1 2/2 3/3\nf 1//1 3//3 4//4\n")
    with pytest.raises(
        InputError, match=r"mesh\.obj: expected texture coordinates in all faces or in none, found v/vt beside v//vn"
    ):
        load_mesh(path)


def test_parts_of_two_materials_may_have_texture_coordinates_or_normals(tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text(QUAD + 4 * "vn 0 0 1\n" + "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 1//1 3//3 4//4\n")
    assert load_mesh(path, uv="xatlas")[0].faces.shape == (2, 3)


def test_materials_in_a_pipe_are_not_waited_for(tmp_path: Path) -> None:
    """A mesh alone needs none; an asset is refused."""
    waited = list[int]()

    def too_long(number: int, _: object) -> None:
        waited.append(number)
        raise TimeoutError

    path = tmp_path / "mesh.obj"
    path.write_text("mtllib pipe.mtl\n" + QUAD + "usemtl a\nf 1/1 2/2 3/3\n")
    os.mkfifo(tmp_path / "pipe.mtl")
    before = signal.signal(signal.SIGALRM, too_long)
    signal.setitimer(signal.ITIMER_REAL, 30, 10)
    try:
        assert len(load_mesh(path)[0].faces) == 1
        with pytest.raises(InputError, match=r"mesh\.obj: mtllib: pipe\.mtl: no such file"):
            read_asset(path, note=print)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert not waited


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda ply: ply.vertices.__setitem__(([3, 5], 1), np.nan), r"2 of \d+ vertices are NaN or Inf"),
        (lambda ply: ply.faces.__setitem__((7, 1), len(ply.vertices)), r"not a readable mesh"),
        (lambda ply: ply.faces.__setitem__((7, 1), -1), r"expected faces of vertices 0 to \d+, found -1 to"),
        (lambda ply: ply.vertices.__setitem__(slice(None), ply.vertices[:1]), r"every one of the \d+ triangles has zero area"),
    ],
)
def test_refuses_broken_meshes(tmp_path: Path, ply: Ply, spoil: Callable[[Ply], None], says: str) -> None:
    spoil(ply)
    refused(ply.write(tmp_path / "mesh.ply"), says)


@pytest.mark.parametrize("with_normals", [True, False])
def test_triangles_are_turned_outward(tmp_path: Path, with_normals: bool) -> None:
    """Of a box about the origin that is wound inward, with normals that point outward or with none; away from the middle is out."""
    box = trimesh.creation.box()
    normals = box.vertices / np.linalg.norm(box.vertices, axis=1, keepdims=True)
    ply = Ply(box.vertices, box.faces[:, ::-1], normals if with_normals else None, 0.5 + box.vertices[:, :2])
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    assert "turned round" in notes[-1]
    places = mesh.vertices[mesh.faces]
    across = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    assert ((across * places.mean(1)).sum(1) > 0.1).all()
    assert ((mesh.normals * mesh.vertices).sum(1) > 0.5).all()


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


@pytest.mark.parametrize("uv", ["mesh", "xatlas"])
def test_map_coordinates_are_refused(tmp_path: Path, ply: Ply, uv: str) -> None:
    """In single precision, vertices a metre apart would fall together there."""
    size = float(np.linalg.norm(np.ptp(ply.vertices, axis=0)))
    ply.vertices[:, 0] += 0.9e4 * size
    load_mesh(ply.write(tmp_path / "mesh.ply"), uv=uv)
    ply.vertices = ply.vertices.astype(float) + [0.2e4 * size, 0, 0]
    refused(ply.write(tmp_path / "mesh.ply"), "expected an object at most 10000 times its size from the origin", uv=uv)


@pytest.mark.parametrize(("value", "found"), [(1.5, r"1\.5"), (-0.25, r"-0\.25"), (np.nan, "nan")])
def test_uv_outside_the_unit_square(tmp_path: Path, ply: Ply, value: float, found: str) -> None:
    ply.uv[11, 0] = value
    path = ply.write(tmp_path / "mesh.ply")
    refused(path, rf"expected UV within \[0, 1\], found .*{found}.*reader\.options\.uv=xatlas")
    mesh, notes = load_mesh(path, uv="xatlas")
    assert notes == ("mesh.ply: UV made by xatlas",)
    assert 0 <= mesh.uv.min() < mesh.uv.max() <= 1


def test_a_mesh_without_uv_is_refused_or_unwrapped(tmp_path: Path, ply: Ply, tiny: Scene) -> None:
    """What xatlas makes leaves the surface where it was."""
    ply.uv = None
    path = ply.write(tmp_path / "mesh.ply")
    refused(path, "no UV.*reader.options.uv=xatlas")
    mesh, notes = load_mesh(path, uv="xatlas")
    assert notes == ("mesh.ply: UV made by xatlas",)
    np.testing.assert_allclose(corners(mesh), corners(tiny.mesh), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    assert 0 <= mesh.uv.min() < mesh.uv.max() <= 1


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


def test_stored_normals_stay_where_one_that_nobody_needs_is_not_finite(tmp_path: Path, ply: Ply, tiny: Scene) -> None:
    """Also beside a triangle of one point, whose smooth normal is none."""
    ply.vertices = np.concatenate([ply.vertices, [[9, 9, 9]]])
    ply.normals = np.concatenate([ply.normals, [[np.nan] * 3]])
    ply.uv = np.concatenate([ply.uv, [[0.5, 0.5]]])
    ply.faces = np.concatenate([ply.faces, [[len(ply.vertices) - 1] * 3]])
    mesh, notes = load_mesh(ply.write(tmp_path / "mesh.ply"))
    np.testing.assert_allclose(mesh.normals, tiny.mesh.normals, atol=1e-6)
    assert sum("dropped 1 " in note for note in notes) == len(notes) == 2


def test_a_ply_of_several_textures_is_refused_or_unwrapped(tmp_path: Path, ply: Ply) -> None:
    """As photogrammetry writes it, each with coordinates from 0 to 1: one would lie over the other."""
    text, comments = ply.write(tmp_path / "mesh.ply").read_text(), "".join(f"comment TextureFile {name}.png\n" for name in "ab")
    (tmp_path / "mesh.ply").write_text(text.replace("element vertex", f"{comments}element vertex", 1))
    refused(tmp_path / "mesh.ply", "expected UV for one texture, found those for 2; run with reader.options.uv=xatlas")
    assert len(load_mesh(tmp_path / "mesh.ply", uv="xatlas")[0].faces) == len(ply.faces)


def test_a_texture_that_is_not_there_is_no_traceback(tmp_path: Path, ply: Ply, capfd: pytest.CaptureFixture[str]) -> None:
    path = ply.write(tmp_path / "mesh.ply")
    path.write_text(path.read_text().replace("element vertex", "comment TextureFile mesh.png\nelement vertex", 1))
    code = f"from pathlib import Path; from ia_bench.geometry.mesh import load_mesh; load_mesh(Path({str(path)!r}))"
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "IA_BENCH_CACHE": str(tmp_path / "cache")})
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("corner", ["0 0", ".1 0"], ids=["one place", "split"])
def test_normals_of_a_ply_whose_faces_have_uv_stay_with_their_vertices(tmp_path: Path, corner: str) -> None:
    """As MeshLab writes it, here with a vertex that no face has: split, there are as many vertices as there were."""
    header = [
        "ply",
        "format ascii 1.0",
        "element vertex 5",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
    ]
    header += ["element face 2", "property list uchar int vertex_indices", "property list uchar float texcoord", "end_header"]
    vertices = np.array(
        [[9, 9, 9, 1, 0, 0], [0, 0, 0, 0, 0, 1], [1, 0, 0, 0.6, 0, 0.8], [1, 1, 0, 0, 0.6, 0.8], [0, 1, 0, 0, -0.6, 0.8]]
    )
    faces = ["3 1 2 3 6 0 0 1 0 1 1", f"3 1 3 4 6 {corner} 1 1 0 1"]
    path = tmp_path / "mesh.ply"
    path.write_text("\n".join([*header, *(" ".join(map(str, row)) for row in vertices), *faces]) + "\n")
    mesh, notes = load_mesh(path)
    assert notes == ()
    normals = {tuple(row[:3]): row[3:] for row in vertices}
    np.testing.assert_allclose(mesh.normals, [normals[tuple(place)] for place in mesh.vertices.tolist()], atol=1e-6)


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
    expected = {(0, 0): [(0, 0), (0.5, 0.5)], (1, 1): [(0.4, 0.4), (0.9, 0.9)], (1, 0): [(0.4, 0)], (0, 1): [(0.5, 0.9)]}
    for position, uvs in expected.items():
        here = (mesh.vertices[:, :2] == position).all(1)
        np.testing.assert_allclose(sorted(map(tuple, mesh.uv[here])), uvs, atol=1e-6)


def test_a_kept_mesh_is_that_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read again from the cache, parsed by nobody, with its notes; a file that has changed is read anew."""
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "mesh.ply"
    trimesh.creation.box().export(path)
    mesh, notes = load_mesh(path, uv="xatlas")
    with monkeypatch.context() as without:
        without.delattr("ia_bench.geometry.mesh.parsed_by_trimesh")
        again, said = load_mesh(path, uv="xatlas")
    assert said == notes != ()
    for name in ("vertices", "faces", "normals", "uv"):
        np.testing.assert_array_equal(getattr(again, name), getattr(mesh, name))
        assert getattr(again, name).dtype == getattr(mesh, name).dtype
    trimesh.creation.box((2, 2, 2)).export(path)
    assert np.ptp(load_mesh(path, uv="xatlas")[0].vertices) > 1.5 * np.ptp(mesh.vertices)
