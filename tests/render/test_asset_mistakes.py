"""Meshes with textures of other programs that cannot be read as they are meant: one sentence each."""

import re
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_assets import UV, gltf, obj, picture, read, square
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.render.asset_files import glb
from ia_bench.scenes.exr import write_exr


def set_in(*keys: str | int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(header: dict[str, Any]) -> None:
        place: Any = header
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return change


def set_of_coordinates(**values: Any) -> Callable[[dict[str, Any]], None]:
    def change(header: dict[str, Any]) -> None:
        header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]] |= values

    return change


def mirrored(header: dict[str, Any]) -> None:
    header["samplers"], header["textures"][0]["sampler"] = [{"wrapS": 33648}], 0


def without_triangles(header: dict[str, Any]) -> None:
    header["accessors"][header["meshes"][0]["primitives"][0]["indices"]]["count"] = 0


BASE = ("materials", 0, "pbrMetallicRoughness", "baseColorTexture")
FACTOR_OF_2 = {"pbrMetallicRoughness": {"roughnessFactor": 2}}
GLTF_MISTAKES = {
    "second texture coordinates": (set_in(*BASE, "texCoord", value=1), "a.glb: material 0: baseColorTexture: expected the first"),
    "moved texture": (set_in(*BASE, "extensions", value={"KHR_texture_transform": {}}), "or a transform of them"),
    "texture absent": (set_in("images", 0, value={"uri": "gone.png"}), "expected a picture"),
    "other model": (
        set_in("materials", 0, value={"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}}),
        "found specular-glossiness",
    ),
    "compressed": (set_in("extensionsRequired", value=["KHR_draco_mesh_compression"]), "found KHR_draco_mesh_compression"),
    "quantized": (set_of_coordinates(componentType=5123, normalized=True), "found whole numbers for TEXCOORD_0"),
    "sparse": (set_of_coordinates(sparse={"count": 1}), "found sparse accessors"),
    "a fan": (set_in("meshes", 0, "primitives", 0, "mode", value=6), "found triangle fans"),
    "mirrored beyond its edge": (mirrored, "expected textures that repeat"),
    "out of range": (
        set_in("materials", 0, "pbrMetallicRoughness", "roughnessFactor", value=2),
        "a.glb: material 0: expected roughness from 0 to 1, found 2 to 2",
    ),
    "a name": (set_in("materials", 0, value={"name": "steel", **FACTOR_OF_2}), "material 0 (steel): expected roughness"),
    **{
        f"{'.'.join(map(str, keys))} = {value}": (set_in(*keys, value=value), "a.glb: expected glTF 2.0, found what is none")
        for keys, value in {
            ("materials",): {},
            ("materials", 0): None,
            ("meshes",): None,
            BASE: 5,
            ("meshes", 0, "primitives", 0, "attributes"): None,
            ("materials", 0, "emissiveFactor"): None,
            ("textures", 0, "sampler"): 3,
            ("nodes",): None,
            ("meshes", 0, "weights"): 3,
        }.items()
    },
    "no triangles": (without_triangles, "expected triangles, found none"),
}


@pytest.mark.parametrize("case", GLTF_MISTAKES)
def test_what_is_not_done_of_gltf_is_refused(tmp_path: Path, case: str) -> None:
    change, said = GLTF_MISTAKES[case]
    with pytest.raises(InputError, match=re.escape(said)):
        read(gltf(tmp_path / "a.glb", change, UV + [1, 0], baseColorTexture=Image.fromarray(picture(0))))


def test_a_picture_of_another_folder_is_not_taken(tmp_path: Path) -> None:
    Image.fromarray(picture(1)).save(tmp_path / "kd.png")
    elsewhere = set_in("images", 0, value={"uri": "textures/kd.png"})
    with pytest.raises(InputError, match="expected a picture"):
        read(gltf(tmp_path / "a.glb", elsewhere, baseColorTexture=Image.fromarray(picture(0))))


@pytest.mark.parametrize("value", [-0.5, np.nan, np.inf])
def test_colours_of_vertices_that_are_none_are_refused(tmp_path: Path, value: float) -> None:
    colours = np.full((4, 4), 0.5, np.float32)
    colours[2, 1] = value

    def coloured(header: dict[str, Any]) -> None:
        place = header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["POSITION"]] | {"type": "VEC4"}
        header["buffers"].append({"uri": f"data:;base64,{b64encode(colours.tobytes()).decode()}", "byteLength": colours.nbytes})
        header["bufferViews"].append({"buffer": len(header["buffers"]) - 1, "byteLength": colours.nbytes})
        header["accessors"].append(place | {"bufferView": len(header["bufferViews"]) - 1, "byteOffset": 0})
        header["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = len(header["accessors"]) - 1

    with pytest.raises(InputError, match=r"a\.glb: material 0: expected colours of vertices of 0 and more, found"):
        read(gltf(tmp_path / "a.glb", coloured))


OBJ_MISTAKES = {
    "no albedo": ("newmtl one\nPr .5", "expected an albedo, map_Kd or Kd"),
    "texture absent": ("newmtl one\nmap_Kd gone.png", "map_Kd: gone.png: no such file"),
    "moved texture": ("newmtl one\nmap_Kd -s 2 2 1 kd.png", "found one that is moved"),
    "no number": ("newmtl one\nKd a b c", "Kd: expected 3 number(s) >= 0"),
    "changed values": ("newmtl one\nmap_Kd -mm 0 0.5 kd.png", "found one that is moved or of other values"),
    "another channel": ("newmtl one\nKd 1 1 1\nmap_Pr -imfchan g kd.png", "found one that is moved or of other values"),
    "other name": (
        "newmtl two\nKd 1 1 1\nnewmtl three\nKd 1 1 1",
        "usemtl one: expected a material of my materials.mtl, found none",
    ),
    "one other name": ("newmtl two\nKd 1 1 1", "usemtl one: expected a material of my materials.mtl, found none"),
    "empty": ("", "expected newmtl NAME, found none"),
}


@pytest.mark.parametrize("case", OBJ_MISTAKES)
def test_what_is_wrong_with_an_obj_is_said(tmp_path: Path, case: str) -> None:
    mtl, said = OBJ_MISTAKES[case]
    with pytest.raises(InputError, match=re.escape(said)):
        read(obj(tmp_path, mtl, kd=picture(0)))


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text("ply\n")
    (tmp_path / "b.glb").write_bytes(b"no glTF at all, but long enough")
    for name, said in (("a.ply", "expected a mesh with textures"), ("b.glb", "binary glTF 2.0"), ("c.obj", "no such mesh")):
        with pytest.raises(InputError, match=said):
            read(tmp_path / name)
    (tmp_path / "d.glb").write_bytes(glb(square(), np.ones((1, 1, 3), np.float32), np.ones((1, 1), np.float32)))
    write_exr(tmp_path / "dark.exr", np.full((2, 4, 3), -1.0), half=False)
    with pytest.raises(InputError, match="expected radiance, found the negative value -1"):
        read(tmp_path / "d.glb", light=tmp_path / "dark.exr")


def test_a_part_without_a_surface_is_left_out_and_told(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nnewmtl b\nKd 1 1 1\n")
    whole = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nusemtl a\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(f"{whole}usemtl b\nf 4 4 4\n")
    asset, notes = read(tmp_path / "a.obj", up="z")
    assert len(asset.mesh.faces) == 1
    assert "a.obj: 1 of 2 parts have no surface and are left out" in notes
