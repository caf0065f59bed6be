"""Mesh files of several parts and materials: normals and texture coordinates of each, and what would be lost without a word."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import load_mesh
from ia_bench.scenes.scene import Mesh, Scene

HARD = np.array([[0.6, 0.0, 0.8]] * 3)
"""Normals of a triangle in the plane z = 0 that no program would compute from it."""


def part(normals: np.ndarray | None, place: float = 0.0) -> trimesh.Trimesh:
    """A triangle with texture coordinates, from ``place`` on, with these normals (3, 3), or none."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    uv = TextureVisuals(uv=place + 0.4 * corners[:, :2])
    return trimesh.Trimesh(corners, [[0, 1, 2]], vertex_normals=normals, visual=uv, process=False)


def written(path: Path, *parts: tuple[trimesh.Trimesh, np.ndarray]) -> Path:
    """A glTF file of these parts, each placed by its matrix (4, 4)."""
    scene = trimesh.Scene()
    for number, (mesh, matrix) in enumerate(parts):
        scene.add_geometry(mesh, geom_name=f"part {number}", node_name=f"node {number}", transform=matrix)
    if path.suffix == ".glb":
        path.write_bytes(scene.export(file_type="glb"))
    for name, content in scene.export(file_type="gltf").items() if path.suffix == ".gltf" else ():
        path.with_name(path.name if name.endswith(".gltf") else name).write_bytes(content)
    return path


def placing(linear: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, (3, 1, 2)
    return matrix


# ---------------------------------------------------------------- what trimesh leaves out of a glTF
def fan(header: dict[str, Any], number: int) -> None:
    header["meshes"][number]["primitives"][0]["mode"] = 6


def sparse(header: dict[str, Any], number: int) -> None:
    place = header["meshes"][number]["primitives"][0]["attributes"]["POSITION"]
    header["accessors"][place]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 0, "componentType": 5125},
        "values": {"bufferView": 1},
    }


def packed(header: dict[str, Any], number: int) -> None:
    header["extensionsRequired"] = ["EXT_meshopt_compression"]


def sparse_faces(header: dict[str, Any], number: int) -> None:
    place = header["meshes"][number]["primitives"][0]["indices"]
    header["accessors"][place]["sparse"] = {"count": 1, "indices": {"bufferView": 0, "componentType": 5125}, "values": {}}


def morphed(header: dict[str, Any], number: int) -> None:
    header["meshes"][number]["primitives"][0]["targets"] = [{"POSITION": 0}]
    header["meshes"][number]["weights"] = [0.5]


def of_node(key: str, value: Any) -> Callable[[dict[str, Any], int], None]:
    def spoil(header: dict[str, Any], number: int) -> None:
        (node,) = [node for node in header["nodes"] if node.get("mesh") == number]
        node[key] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (fan, "triangle fans"),
        (sparse, "sparse accessors"),
        (sparse_faces, "sparse accessors"),
        (packed, "EXT_meshopt_compression"),
        (morphed, "morph targets with weights"),
        (of_node("weights", [0, 0.5]), "morph targets with weights"),
        (of_node("skin", 0), "a skin"),
        (of_node("extensions", {"EXT_mesh_gpu_instancing": {"attributes": {}}}), "EXT_mesh_gpu_instancing"),
    ],
)
def test_a_gltf_of_which_parts_would_be_lost_is_refused(tmp_path: Path, spoil: Callable[..., None], found: str) -> None:
    path = written(tmp_path / "mesh.gltf", (part(HARD), np.eye(4)), (part(HARD, 0.5), placing(np.eye(3))))
    assert len(load_mesh(path)[0].faces) == 2
    header = json.loads(path.read_text())
    spoil(header, 1)
    path.write_text(json.dumps(header))
    with pytest.raises(InputError, match=rf"mesh\.gltf: expected triangles with plain coordinates .*, found {found}$"):
        load_mesh(path)


@pytest.mark.parametrize("below", ["a camera", "a camera with a mesh", "lines"])
def test_what_hangs_below_a_camera_or_lines_is_read_where_it_lies(tmp_path: Path, below: str) -> None:
    """trimesh leaves such nodes out, with their places; files are named by URIs, in which a blank is %20."""
    path = written(tmp_path / "mesh.gltf", (part(HARD), np.eye(4)), (part(HARD, 0.5), placing(np.eye(3))))
    header = json.loads(path.read_text())
    (first, second) = [number for number, node in enumerate(header["nodes"]) if "mesh" in node]
    node = (
        {"translation": [0, 0, 7], "camera": 0} if "camera" in below else {"translation": [0, 0, 7], "mesh": len(header["meshes"])}
    )
    header["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    header["meshes"].append({"primitives": [{"mode": 3, "attributes": header["meshes"][0]["primitives"][0]["attributes"]}]})
    header["nodes"].append(node | ({"mesh": header["nodes"][first]["mesh"]} if "with" in below else {"children": [first]}))
    header["scenes"][0]["nodes"] = [second, len(header["nodes"]) - 1]
    for buffer in header["buffers"]:
        (tmp_path / buffer["uri"]).rename(tmp_path / f"its {buffer['uri']}")
        buffer["uri"] = f"its%20{buffer['uri']}"
    path.write_text(json.dumps(header))
    mesh, _ = load_mesh(path)
    assert sorted(mesh.vertices[:, 2].tolist()) == [2, 2, 2, 7, 7, 7]


# ---------------------------------------------------------------- texture coordinates of several materials
def by_material(mesh: Mesh, notes: tuple[str, ...]) -> None:
    """Two materials, one of each side of x = 2, have half of the square each."""
    far = mesh.vertices[:, 0] > 2
    (low, high) = sorted([mesh.uv[far, 0], mesh.uv[~far, 0]], key=np.min)
    assert 0 < low.min() < 0.01
    assert 0.49 < low.max() < 0.5 < high.min() < 0.51
    assert 0.99 < high.max() < 1
    for rows in (mesh.uv[far, 1], mesh.uv[~far, 1]):
        assert 0.98 < np.ptp(rows) < 1
    assert "texture coordinates of 2 materials are laid side by side" in notes[-1]


def test_materials_have_as_many_texels_whatever_their_textures_are(tmp_path: Path) -> None:
    """A picture of 256 x 256 texels, and one colour: what is recovered has no less room for that."""
    scene, picture = trimesh.Scene(), Image.new("RGB", (256, 256), (200, 0, 0))
    materials = PBRMaterial(name="a", baseColorTexture=picture), PBRMaterial(name="b", baseColorFactor=[0.0, 0.0, 1.0, 1.0])
    for material, place in zip(materials, (0, 3), strict=True):
        corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        visual = TextureVisuals(uv=corners[:, :2], material=material)
        scene.add_geometry(trimesh.Trimesh(corners + [place, 0, 0], [[0, 1, 2]], visual=visual, process=False))
    scene.export(tmp_path / "mesh.glb")
    by_material(*load_mesh(tmp_path / "mesh.glb"))


def test_materials_of_an_obj_lie_side_by_side_without_its_mtl(tmp_path: Path) -> None:
    """Both have all of the square to themselves; trimesh drops their names, and would lay one over the other."""
    obj = "".join(f"v {x + place} {y} 0\n" for place in (0, 3) for x, y in ((0, 0), (1, 0), (0, 1)))
    obj += "vt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 4/1 5/2 6/3\n"
    (tmp_path / "mesh.obj").write_text(obj)
    by_material(*load_mesh(tmp_path / "mesh.obj"))


def test_nameless_materials_of_one_colour_have_places_of_their_own(tmp_path: Path) -> None:
    """Five in two rows of three, each at least two of 512 texels from the next."""
    header = json.loads(written(tmp_path / "mesh.gltf", *((part(HARD, 0.1 * n), np.eye(4)) for n in range(5))).read_text())
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    (tmp_path / "uv.bin").write_bytes(uv.tobytes())
    header["buffers"].append({"uri": "uv.bin", "byteLength": uv.nbytes})
    header["bufferViews"].append({"buffer": len(header["buffers"]) - 1, "byteLength": uv.nbytes})
    view = {"bufferView": len(header["bufferViews"]) - 1, "componentType": 5126, "count": 3, "type": "VEC2"}
    header["accessors"].append(view)
    header["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}] * 5
    for number, mesh in enumerate(header["meshes"]):
        mesh["primitives"][0]["attributes"]["TEXCOORD_0"] = len(header["accessors"]) - 1
        mesh["primitives"][0]["material"] = number
    (tmp_path / "mesh.gltf").write_text(json.dumps(header))
    mesh, notes = load_mesh(tmp_path / "mesh.gltf")
    assert "texture coordinates of 5 materials are laid side by side" in notes[-1]
    boxes = [(mesh.uv[face].min(0), mesh.uv[face].max(0)) for face in mesh.faces]
    for number, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[number + 1 :]:
            assert (np.maximum(low - other_high, other_low - high) > 1.99 / 512).any()


# ---------------------------------------------------------------- normals of several parts
@pytest.mark.parametrize(
    "linear", [Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.diag([2.0, 0.5, 3.0]), np.diag([1.0, 1.0, -1.0])]
)
def test_normals_turn_with_their_part(tmp_path: Path, linear: np.ndarray) -> None:
    """They stay at right angles to what was in their plane, and on their side of it, however a part is turned, scaled, mirrored."""
    path = written(tmp_path / "mesh.glb", (part(HARD), np.eye(4)), (part(HARD, 0.5), placing(linear)))
    mesh, notes = load_mesh(path)
    assert notes == ()
    far = mesh.vertices[:, 2] > 1  # the part that is placed
    moved = mesh.normals[far]
    np.testing.assert_allclose(mesh.normals[~far], HARD, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1, atol=1e-5)
    for across in ([0.0, 1, 0], [-0.8, 0, 0.6]):  # at right angles to HARD
        np.testing.assert_allclose(moved @ (linear @ across), 0, atol=1e-5)
    assert (moved @ (linear @ HARD[0]) > 0).all()


# ---------------------------------------------------------------- parts that are inside out
@pytest.mark.parametrize(("turned", "hollow"), [(0, False), (1, False), (1, True)])
def test_each_closed_part_is_turned_outward_but_a_hollow(tmp_path: Path, turned: int, hollow: bool) -> None:
    """A large ball and a small one, of which one is inside out; where the small one is in the large one, it is its hollow."""
    balls = [trimesh.creation.icosphere(2, radius) for radius in (1.0, 0.5)]
    balls[turned].invert()
    balls[1].apply_translation([0 if hollow else 2.0, 0, 0])
    whole = trimesh.util.concatenate(balls)
    uv = TextureVisuals(uv=0.4 + 0.1 * whole.vertices[:, :2])
    trimesh.Trimesh(whole.vertices, whole.faces, visual=uv, process=False).export(tmp_path / "mesh.ply")
    mesh, notes = load_mesh(tmp_path / "mesh.ply")
    corners = mesh.vertices[mesh.faces].astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    small = np.arange(len(mesh.faces)) >= len(balls[0].faces)
    centre = np.where(small[:, None], balls[1].vertices.mean(0), 0)
    outward = (across * (corners.mean(1) - centre)).sum(1) > 0
    assert outward[~small].all()
    assert outward[small].all() != hollow
    assert any("closed parts (1) that are inside out" in note for note in notes) != hollow


def test_cards_with_two_sides_are_not_inside_out(tmp_path: Path) -> None:
    """What they enclose is rounding, of either sign."""
    for number in range(8):
        turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(number).random(3))
        corners, sides = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
        card = trimesh.Trimesh(corners, sides, process=False)
        card.apply_transform(turn)
        card.export(tmp_path / "mesh.ply")
        assert not any("inside out" in note for note in load_mesh(tmp_path / "mesh.ply", uv="xatlas")[1])


def test_types_that_glTF_has_not_are_told(tmp_path: Path, tiny: Scene) -> None:
    mesh = trimesh.Trimesh(tiny.mesh.vertices, tiny.mesh.faces, process=False)
    content = json.loads(trimesh.Scene(mesh).export(file_type="gltf")["model.gltf"])
    (tmp_path / "mesh.gltf").write_text(json.dumps({**content, "extensionsRequired": None}))
    for name, data in trimesh.Scene(mesh).export(file_type="gltf").items():
        if name != "model.gltf":
            (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=r"mesh\.gltf: expected glTF 2\.0, found what is none \(TypeError"):
        load_mesh(tmp_path / "mesh.gltf", uv="xatlas")
