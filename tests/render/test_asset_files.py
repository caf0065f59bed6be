"""Meshes with textures of other programs: what is read is what was written, to rounding, and what cannot be read is one sentence.

Expected values are computed from the numbers that the files are written from, by the formats' own definitions.
"""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from made_assets import FACES, HALF, UV, VERTICES, at, at_corner, gltf, obj, picture, read, square
from PIL import Image
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.render.asset_files import ROUGHNESS, glb
from ia_bench.render.asset_parts import asset_files
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Camera


def test_our_own_file_comes_back(tmp_path: Path) -> None:
    albedo, roughness, metallic = (np.random.default_rng(n).random((16, 16, c), np.float32) for n, c in ((0, 3), (1, 1), (2, 1)))
    (tmp_path / "a.glb").write_bytes(glb(square(), albedo, roughness[..., 0], metallic[..., 0]))
    light = np.random.default_rng(3).random((4, 8, 3), np.float32)
    write_exr(tmp_path / "light.exr", light, half=False)
    asset, _ = read(tmp_path / "a.glb", light=tmp_path / "light.exr")
    for part in ("vertices", "faces", "normals"):
        np.testing.assert_array_equal(getattr(asset.mesh, part), getattr(square(), part))
    np.testing.assert_allclose(asset.mesh.uv, square().uv, atol=1e-7)
    assert np.abs(asset.albedo - albedo).max() < 0.5 / 255 * 2.3  # the steepest that the decoding of sRGB is
    assert np.abs(asset.roughness - roughness[..., 0]).max() <= HALF
    assert np.abs(asset.metallic - metallic[..., 0]).max() <= HALF
    np.testing.assert_array_equal(asset.light, light)


def test_factors_are_not_rounded_and_multiply_textures(tmp_path: Path) -> None:
    base, packed = picture(0), picture(1, 4, 4)
    factors = {"baseColorFactor": [0.013, 0.5, 0.25, 1], "roughnessFactor": 0.3, "metallicFactor": 0.7}

    def change(header: dict[str, Any]) -> None:
        header["materials"][0].setdefault("pbrMetallicRoughness", {}).update(factors)

    pictures = {"baseColorTexture": Image.fromarray(base), "metallicRoughnessTexture": Image.fromarray(packed)}
    asset, _ = read(gltf(tmp_path / "a.glb", change, **pictures))
    np.testing.assert_allclose(asset.albedo, [0.013, 0.5, 0.25] * srgb_to_linear(base / 255), rtol=1e-5)
    np.testing.assert_allclose(asset.roughness, 0.3 * packed[..., 1] / 255, rtol=1e-5)
    np.testing.assert_allclose(asset.metallic, 0.7 * packed[..., 2] / 255, rtol=1e-5)
    flat, _ = read(gltf(tmp_path / "b.glb", change))
    np.testing.assert_allclose(flat.albedo, np.reshape([0.013, 0.5, 0.25], (1, 1, 3)), rtol=1e-6)


def test_a_material_without_a_name_and_with_a_second_model_keeps_its_own_values(tmp_path: Path) -> None:
    base, other = picture(0), picture(1)
    glossy = {
        "KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 1}, "glossinessFactor": 1.0},
        "KHR_materials_ior": {},
    }

    def change(header: dict[str, Any]) -> None:
        header["samplers"], header["materials"][0]["name"], header["materials"][0]["extensions"] = [{"magFilter": 9728}], "", glossy
        header["materials"][0]["pbrMetallicRoughness"].pop("metallicRoughnessTexture")
        header["materials"][0]["pbrMetallicRoughness"] |= {"baseColorFactor": [0.5, 0.25, 1, 1], "roughnessFactor": 0.3}

    pictures = {"baseColorTexture": Image.fromarray(base), "metallicRoughnessTexture": Image.fromarray(other)}
    asset, notes = read(gltf(tmp_path / "a.glb", change, **pictures))
    np.testing.assert_allclose(asset.albedo, [0.5, 0.25, 1] * srgb_to_linear(base / 255), rtol=1e-5)
    assert (asset.roughness == np.float32(0.3)).all()
    assert (asset.metallic == 1).all()  # what the specification has for a file that says none
    assert [note for note in notes if "metallicFactor of material 0" in note]
    assert [note for note in notes if "KHR_materials_ior, KHR_materials_pbrSpecularGlossiness left out" in note]
    assert [note for note in notes if "textures are looked up bilinearly, not by the filter NEAREST" in note]


def test_up_matrix_and_turned_light(tmp_path: Path) -> None:
    path = gltf(tmp_path / "a.glb", lambda header: None)
    x, y, z = VERTICES.T
    light = np.random.default_rng(0).random((4, 8, 3), np.float32)
    write_exr(tmp_path / "l.exr", light, half=False)
    asset, _ = read(path, light=tmp_path / "l.exr")
    np.testing.assert_allclose(asset.mesh.vertices, np.stack([x, -z, y], -1), atol=1e-6)
    np.testing.assert_array_equal(asset.light, light)
    as_it_is, _ = read(path, up="z", light=tmp_path / "l.exr", light_turn=90)
    np.testing.assert_allclose(as_it_is.mesh.vertices, VERTICES, atol=1e-6)
    np.testing.assert_array_equal(as_it_is.light[:, 2], light[:, 4])  # what was at +x is now at +y, a quarter to the left
    quarter = np.array([[0, -2.0, 0, 5], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])  # larger, turned by 90 degrees, moved
    moved, _ = read(path, up="z", matrix=quarter, light=tmp_path / "l.exr")
    np.testing.assert_allclose(moved.mesh.vertices, np.stack([5 - 2 * y, 2 * x, 2 * z], -1), atol=1e-6)
    np.testing.assert_array_equal(moved.light, as_it_is.light)


def test_the_light_of_nvdiffrec_turned_by_a_quarter_comes_from_where_it_came_from(tmp_path: Path) -> None:
    """There texel (v, u) holds what comes from (sin t sin p, cos t, -sin t cos p) with t = pi v, p = 2 pi u - pi, y up."""
    theta, phi = np.meshgrid((np.arange(32) + 0.5) * np.pi / 32, (np.arange(64) + 0.5) * 2 * np.pi / 64 - np.pi, indexing="ij")
    x, y, z = np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)
    there = np.stack([x, y, z], -1)  # whatever comes from a direction is that direction, and 2
    write_exr(tmp_path / "probe.exr", there + 2, half=False)
    path = gltf(tmp_path / "a.glb", lambda header: None)
    light = torch.from_numpy(read(path, light=tmp_path / "probe.exr", light_turn=90)[0].light)
    ours = torch.from_numpy(np.stack([x, -z, y], -1).reshape(-1, 3)).float()  # the same directions with z up, as for the mesh
    np.testing.assert_allclose(LatLongEnvironment(light).radiance(ours), there.reshape(-1, 3) + 2, atol=1e-5)


def test_obj_by_trimesh(tmp_path: Path) -> None:
    base = picture(0, 8, 8)
    visual = trimesh.visual.TextureVisuals(uv=UV, material=SimpleMaterial(image=Image.fromarray(base), glossiness=30.0))
    trimesh.Trimesh(VERTICES, FACES, visual=visual, process=False).export(tmp_path / "mesh.obj")
    asset, notes = read(tmp_path / "mesh.obj", up="z")
    np.testing.assert_allclose(asset.albedo, srgb_to_linear(base / np.float32(255)), atol=1e-6)
    np.testing.assert_allclose(asset.roughness, (2 / 32) ** 0.25)
    assert any("from Ns 30" in note for note in notes)
    for place, uv in zip(VERTICES, UV, strict=True):
        np.testing.assert_allclose(at_corner(asset, asset.albedo, place), at(asset.albedo, uv[None])[0], atol=1e-5)
    assert {path.name for path in asset_files(tmp_path / "mesh.obj")} == {"mesh.obj", "material.mtl", "material_0.png"}


def test_obj_of_nvdiffrec(tmp_path: Path) -> None:
    kd, ks = picture(0), picture(1)
    mtl = "newmtl one\nbsdf   pbr\nmap_Kd texture_kd.png\nmap_Ks texture_ks.png\nbump texture_n.png\n"
    asset, notes = read(obj(tmp_path, mtl, texture_kd=kd, texture_ks=ks, texture_n=kd))
    np.testing.assert_allclose(asset.albedo, srgb_to_linear(kd / np.float32(255)), atol=1e-6)
    np.testing.assert_allclose(asset.roughness, ks[..., 1] / np.float32(255))
    np.testing.assert_allclose(asset.metallic, ks[..., 2] / np.float32(255))
    assert any("bump" in note for note in notes)


@pytest.mark.parametrize(
    ("mtl", "roughness", "metallic"),
    [
        ("Kd .5 .5 .5\nPr .3", 0.3, None),
        ("Kd .5 .5 .5\nPr .3\nPm .25\nNs 10", 0.3, 0.25),
        ("Kd .5 .5 .5\nPr .3\nPm 0", 0.3, None),
        ("Kd .5 .5 .5\nNs 0", ROUGHNESS, None),
        ("Kd .5 .5 .5\nmap_Ks rough.png", ROUGHNESS, None),  # a specular colour, in plain MTL
    ],
)
def test_numbers_of_mtl(tmp_path: Path, mtl: str, roughness: float, metallic: float | None) -> None:
    asset, notes = read(obj(tmp_path, f"newmtl one\n{mtl}\n"))
    assert (asset.roughness == np.float32(roughness)).all()
    assert asset.metallic is None if metallic is None else bool((asset.metallic == metallic).all())
    assert asset.assumed == ({"roughness"} if roughness == ROUGHNESS else set())
    assert any("unknown" in note for note in notes) == (roughness == ROUGHNESS)


def test_colours_of_vertices_in_an_obj_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = obj(tmp_path, "newmtl one\nKd .5 .5 .5\nPr 1\n")
    assert not any("colours of vertices" in note for note in read(path)[1])
    path.write_text(re.sub(r"^(v .*)$", r"\1 1 0 0", path.read_text(), flags=re.MULTILINE))
    asset, notes = read(path)
    assert any("colours of vertices are left out" in note for note in notes)
    assert (asset.albedo == 0.5).all()


def test_what_is_commented_in_an_obj_is_not_used(tmp_path: Path) -> None:
    faces = "usemtl one\nf 1/1 2/2 3/3\n# usemtl two\nf 2/2 4/4 3/3\n"
    asset, _ = read(obj(tmp_path, "newmtl one\nKd .5 .5 .5\nPr .3\nnewmtl two\nKd .1 .1 .1\nPr .9\n", faces))
    assert (asset.albedo == 0.5).all()
    assert (asset.roughness == np.float32(0.3)).all()


def test_files_of_an_asset_are_known_whatever_happens_to_a_map_that_is_left_out(tmp_path: Path) -> None:
    path = obj(
        tmp_path, "newmtl one\nmap_Kd kd.png\nmap_Bump -s 2 2 1 n.png\nmap_d -imfchan m kd.png\n", kd=picture(0), n=picture(1)
    )
    assert {file.name for file in asset_files(path)} == {"mesh.obj", "my materials.mtl", "kd.png", "n.png"}
    read(path)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("Ke 0 0 0\nd 1.0\nTr 1", []),
        ("Ke 5 5 5", ["light of its own (ke)"]),
        ("d .3", ["transparency (d)"]),
        ("Tr .7", ["transparency (tr)"]),
        ("Tr 0.0", []),
    ],
)
def test_light_and_transparency_of_mtl_are_told(tmp_path: Path, lines: str, told: list[str]) -> None:
    _, notes = read(obj(tmp_path, f"newmtl one\nKd .5 .5 .5\nPr .3\n{lines}\n"))
    assert [note.partition("its ")[2].partition(" is left out")[0] for note in notes if "left out" in note] == told


def test_parts_without_normals_cost_the_others_none(tmp_path: Path) -> None:
    hard = np.array([[0.6, 0, 0.8]] * 4)
    parts = [
        trimesh.Trimesh(VERTICES + place, FACES, vertex_normals=normals, visual=trimesh.visual.TextureVisuals(uv=UV), process=False)
        for place, normals in ((0, hard), (9, None))
    ]
    content = trimesh.Scene(parts).export(file_type="glb")
    (tmp_path / "a.glb").write_bytes(content)
    asset, notes = read(tmp_path / "a.glb", up="z")
    bare = asset.mesh.vertices[:, 0] > 5
    np.testing.assert_allclose(asset.mesh.normals[~bare], hard, atol=1e-6)
    assert (np.abs(asset.mesh.normals[bare] - hard) > 0.1).any(1).all()
    assert any("no normals stored of" in note for note in notes)


def test_several_materials_share_one_texture_and_keep_their_values(tmp_path: Path) -> None:
    wide, tall = picture(0, 4, 16), picture(1, 8, 2)
    mtl = "newmtl one\nmap_Kd wide.png\nPr .25\nnewmtl two\nmap_Kd tall.png\nmap_Pr tall.png\nnewmtl three\nKd .1 .2 .3\nPr 1\n"
    faces = "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 2/2 4/4 3/3\nusemtl three\nf 1 4 3\n"
    asset, notes = read(obj(tmp_path, mtl, faces, wide=wide, tall=tall), up="z")
    assert asset.albedo.shape[0] == asset.albedo.shape[1]
    assert any("side by side" in note for note in notes)
    rng = np.random.default_rng(0)
    corners, uv = asset.mesh.vertices[asset.mesh.faces], asset.mesh.uv[asset.mesh.faces]
    expected = {0: (wide, 0.25), 1: (tall, None), 2: (None, 1.0)}
    for triangle in range(3):
        which = [np.abs(VERTICES - corner).sum(-1).argmin() for corner in corners[triangle]]
        number = {frozenset((0, 1, 2)): 0, frozenset((1, 2, 3)): 1, frozenset((0, 2, 3)): 2}[frozenset(which)]
        weights = rng.dirichlet(np.ones(3), 200)
        there, before = weights @ uv[triangle], weights @ UV[which]
        image, roughness = expected[number]
        albedo = np.full((200, 3), [0.1, 0.2, 0.3]) if image is None else at(srgb_to_linear(image / np.float32(255)), before)
        np.testing.assert_allclose(at(asset.albedo, there), albedo, atol=1e-5)
        rough = at(image[..., 0] / np.float32(255), before)[:, 0] if roughness is None else roughness
        np.testing.assert_allclose(at(asset.roughness, there)[:, 0], rough, atol=1e-5)


def test_blenders_own_exporter() -> None:
    """A sphere with painted maps about (0, 0, .5), and a plain cube about (.8, .1, .3), z up (datasets/recipes/by_blender.py)."""
    rng = np.random.default_rng(0)
    base, packed = (rng.integers(0, 256, (8, 8, 3))[::-1] / np.float32(255) for _ in range(2))  # Blender's first row is the lowest
    asset, notes = read(Path(__file__).with_name("by_blender.glb"))
    np.testing.assert_allclose(asset.mesh.vertices.min(0), [-0.5, -0.5, 0], atol=1e-3)
    np.testing.assert_allclose(asset.mesh.vertices.max(0), [1.1, 0.5, 1], atol=1e-3)
    centres = asset.mesh.vertices[asset.mesh.faces].mean(1)
    in_cube = (np.abs(centres - [0.8, 0.1, 0.3]) < 0.301).all(-1)
    middle = asset.mesh.uv[asset.mesh.faces].mean(1)
    plain = at(asset.albedo, middle[in_cube]), at(asset.roughness, middle[in_cube]), at(asset.metallic, middle[in_cube])
    for found, expected in zip(plain, ([0.02, 0.4, 0.1], 0.35, 0), strict=True):
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)
    # Of the sphere, the UV of every vertex follow from its place: longitude and latitude.
    painted = np.unique(asset.mesh.faces[~in_cube])
    x, y, z = (asset.mesh.vertices[painted] - [0, 0, 0.5]).T / 0.5
    inside = (np.abs(z) < 0.99) & (np.abs(np.arctan2(y, x)) < 3)  # off the poles, and off the seam
    uv = np.stack([0.5 + np.arctan2(y, x) / (2 * np.pi), 0.5 + np.arcsin(z.clip(-1, 1)) / np.pi], -1)[inside]
    there = asset.mesh.uv[painted][inside]
    np.testing.assert_allclose(at(asset.albedo, there), at(srgb_to_linear(base), uv), atol=0.01)
    np.testing.assert_allclose(at(asset.roughness, there), at(packed[..., 1], uv), atol=0.01)
    np.testing.assert_allclose(at(asset.metallic, there), at(packed[..., 2], uv), atol=0.01)
    assert notes == ["by_blender.glb: textures of 2 materials are laid side by side into one of 13 x 13 texels"]


@pytest.mark.parametrize("textured", [False, True])
def test_colours_of_vertices_are_baked_and_multiply_the_texture(tmp_path: Path, textured: bool) -> None:
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 51]], np.uint8)
    base = np.full((4, 4, 3), 128, np.uint8)
    material = PBRMaterial(baseColorTexture=Image.fromarray(base), roughnessFactor=0.25)
    visual = trimesh.visual.TextureVisuals(uv=UV, material=material)
    solid = trimesh.Trimesh(VERTICES, FACES, visual=visual, process=False)
    if textured:
        solid.visual.vertex_attributes["color"] = np.c_[colours, np.full(4, 255, np.uint8)]
    else:
        solid.visual = trimesh.visual.ColorVisuals(solid, vertex_colors=colours)
    (tmp_path / "a.glb").write_bytes(trimesh.Scene(solid).export(file_type="glb"))
    asset, notes = read(tmp_path / "a.glb", up="z", texture_size=256)
    assert any("colours of vertices" in note for note in notes)
    factor = srgb_to_linear(np.float32(128 / 255)) if textured else 1.0
    weights = np.array([0.5, 0.3, 0.2])
    for triangle, which in zip(asset.mesh.faces, FACES, strict=True):
        found = at(asset.albedo, weights @ asset.mesh.uv[triangle][None])[0]
        order = [np.abs(VERTICES[which] - asset.mesh.vertices[corner]).sum(-1).argmin() for corner in triangle]
        np.testing.assert_allclose(found, factor * weights @ colours[which][order] / 255, atol=0.02)
    assert asset.assumed == (set() if textured else {"roughness"})


def test_two_meshes_of_one_material_throw_no_light_onto_each_other(tmp_path: Path) -> None:
    """A sheet alone, and far away a box without a lid: in texture coordinates of their own one would lie over the other."""
    box = trimesh.creation.box()
    box.update_faces(box.triangles_center[:, 2] < 0.49)
    box.invert()  # the inside is what light leaves
    sheet = trimesh.Trimesh([[6, 0, 0], [7, 0, 0], [6, 1, 0], [7, 1, 0.0]], [[0, 1, 2], [1, 3, 2]], process=False)
    for solid in (sheet, box):
        material = PBRMaterial(name="one", baseColorFactor=[204] * 3, roughnessFactor=1.0, metallicFactor=0.0)
        solid.visual = trimesh.visual.TextureVisuals(material=material)
    (tmp_path / "two.glb").write_bytes(trimesh.Scene([sheet, box]).export(file_type="glb"))
    asset, notes = read(tmp_path / "two.glb", up="z")
    assert not any("lies over others" in note for note in notes)
    camera = Camera(np.array([[1, 0, 0, 6.5], [0, 1, 0, 0.5], [0, 0, 1, 3], [0, 0, 0, 1.0]]), (40.0, 40.0), (4.0, 4.0), 8, 8)
    found = TexturedReconstruction.of(asset, Stage(asset.mesh, torch.device("cpu")))
    light = LatLongEnvironment(torch.ones(8, 16, 3))
    drawn = found.render([camera], light=light, albedo_scale=None, quality=Quality(1, 256))
    np.testing.assert_allclose(drawn.images[0], 0.8, atol=0.02)  # what a rough, convex surface reflects of a uniform light of 1


def test_a_large_texture_is_reduced_and_one_that_parts_share_told(tmp_path: Path) -> None:
    values = picture(0, 8, 8)
    path = gltf(tmp_path / "a.glb", lambda header: None, baseColorTexture=Image.fromarray(values))
    mean = srgb_to_linear(values / 255).reshape(4, 2, 4, 2, 3).mean((1, 3))
    np.testing.assert_allclose(read(path, texture_size=4)[0].albedo, mean, atol=1e-5)

    def twice(header: dict[str, Any]) -> None:
        header["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
        header["scenes"] = [{"nodes": [0, 1]}]

    _, notes = read(gltf(tmp_path / "a.glb", twice, baseColorTexture=Image.fromarray(picture(0))))
    assert any("50% of the surface lies over others" in note for note in notes)


def test_coordinates_that_are_all_alike_are_made_anew_where_no_texture_has_them(tmp_path: Path) -> None:
    """As exporters fill them in for plain colours; light that the object throws onto itself needs some."""
    asset, notes = read(gltf(tmp_path / "a.glb", lambda header: None, 0 * UV, baseColorFactor=[255, 0, 0, 255], metallicFactor=0.0))
    assert notes == ["a.glb: no normals stored; smooth normals computed"]
    assert np.ptp(asset.mesh.uv, axis=0).min() > 0.3
    np.testing.assert_allclose(asset.albedo, [[[1, 0, 0]]])


def test_textures_of_two_sizes_are_written_into_one_picture(tmp_path: Path) -> None:
    metallic = (picture(0)[..., 0] / 255).astype(np.float32)
    content = glb(square(), np.ones((4, 4, 3), np.float32), np.full((2, 2), 0.4, np.float32), metallic)
    (tmp_path / "a.glb").write_bytes(content)
    asset, _ = read(tmp_path / "a.glb")
    np.testing.assert_allclose(asset.metallic, metallic, atol=HALF)
    np.testing.assert_allclose(asset.roughness, 0.4, atol=HALF)


def test_a_picture_beside_a_binary_file_is_one_of_its_files(tmp_path: Path) -> None:
    Image.fromarray(picture(0)).save(tmp_path / "beside.png")

    def beside(header: dict[str, Any]) -> None:
        header["images"][0] = {"uri": "beside.png"}

    path = gltf(tmp_path / "a.glb", beside, baseColorTexture=Image.fromarray(picture(1)))
    np.testing.assert_allclose(read(path)[0].albedo, srgb_to_linear(picture(0) / 255), atol=1e-5)
    assert asset_files(path) == [path, tmp_path / "beside.png"]
    os.mkfifo(tmp_path / "pipe.glb")  # which nobody writes to: whoever opens it waits for ever
    assert asset_files(tmp_path / "pipe.glb") == [tmp_path / "pipe.glb"]


def test_what_draws_an_asset_has_textures_of_its_own(tmp_path: Path) -> None:
    """One number for all texels may be an array that cannot be written to."""
    asset, _ = read(obj(tmp_path, "newmtl one\nKd .5 .5 .5\nmap_Pr pr.png\nPm 1", pr=picture(0)))
    asset.albedo.flags.writeable = False
    found = TexturedReconstruction.of(asset, Stage(asset.mesh, torch.device("cpu")))
    found.material.albedo.zero_()
    np.testing.assert_array_equal(asset.albedo, 0.5)
