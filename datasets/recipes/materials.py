"""Baking the modelled materials to two textures, three where there is metal, and the one material that Cycles then renders with."""

import contextlib
from pathlib import Path

import bpy
import numpy as np
from atlas import dilate
from geometry import GENERATED, LOCAL
from numpy.typing import NDArray
from PIL import Image

IOR = 1.5

BAKE_SAMPLES = 16
"""Samples per texel: paint finer than a texel is averaged."""

RANGE = {"colour": (0.02, 0.9), "roughness": (0.1, 0.95)}
"""What textures of the benchmark's objects keep to."""

REFUSED = {
    "ShaderNodeFresnel": "depends on the view",
    "ShaderNodeLayerWeight": "depends on the view",
    "ShaderNodeCameraData": "depends on the view",
    "ShaderNodeObjectInfo": "changes when parts are joined",
    "ShaderNodeBump": "relief must be geometry",
    "ShaderNodeNormalMap": "relief must be geometry",
    "ShaderNodeGroup": "hides nodes from these checks",
}

GENERATED_BY_DEFAULT = {
    f"ShaderNodeTex{kind}" for kind in ("Brick", "Checker", "Gabor", "Gradient", "Magic", "Noise", "Voronoi", "Wave")
}
"""Textures that read Generated coordinates when their vector is not connected."""


def encode_srgb(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Encode by the sRGB transfer function (IEC 61966-2-1), linear [0, 1] to encoded [0, 1]."""
    linear = np.asarray(linear, dtype=np.float64)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def decode_srgb(encoded: NDArray[np.floating]) -> NDArray[np.float64]:
    """Inverse of `encode_srgb`."""
    encoded = np.asarray(encoded, dtype=np.float64)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


def bake(item: bpy.types.Object, size: int) -> dict[str, NDArray[np.float32]]:
    """Colour (size, size, 3) linear, roughness and metallic (size, size) of an object with a UV layer "atlas", row 0 on top.

    Raises:
        RuntimeError: if a material cannot be baked; the message names it.
    """
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = BAKE_SAMPLES, False, False
    scene.cycles.seed = 0
    used = sorted({p.material_index for p in item.data.polygons})
    materials = [item.material_slots[index].material for index in used]
    for material in set(materials):
        _keep_texture_coordinates(material)
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    colour = _bake_input(set(materials), "Base Color", size)
    rest = {name: _bake_input(set(materials), name.capitalize(), size)[..., 0] for name in ("roughness", "metallic")}
    return {"colour": colour, **rest}


def _principled(material: bpy.types.Material) -> bpy.types.ShaderNode:
    nodes = material.node_tree.nodes if material.use_nodes else []
    found = [node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]
    if len(found) != 1:
        raise RuntimeError(f"material {material.name!r}: expected exactly one Principled BSDF, found {len(found)}")
    return found[0]


def _keep_texture_coordinates(material: bpy.types.Material) -> None:
    """Replace Object and Generated coordinates by the attributes stored before joining; refuse what cannot be baked."""
    _principled(material)
    tree = material.node_tree
    for node in list(tree.nodes):
        if node.bl_idname in REFUSED:
            raise RuntimeError(f"material {material.name!r}: {node.bl_idname} {REFUSED[node.bl_idname]}")
        if node.bl_idname == "ShaderNodeTexCoord":
            for output, name in (("Object", LOCAL), ("Generated", GENERATED)):
                for link in list(node.outputs[output].links):
                    tree.links.new(_attribute(tree, name), link.to_socket)
        elif node.bl_idname in GENERATED_BY_DEFAULT and not node.inputs["Vector"].links:
            tree.links.new(_attribute(tree, GENERATED), node.inputs["Vector"])


def _attribute(tree: bpy.types.NodeTree, name: str) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_type, node.attribute_name = "GEOMETRY", name
    return node.outputs["Vector"]


def _bake_input(materials: set[bpy.types.Material], name: str, size: int) -> NDArray[np.float32]:
    """Bake one input of every material's Principled BSDF as emission, (size, size, 3), all texels filled."""
    target = bpy.data.images.new(name, size, size, alpha=True, float_buffer=True, is_data=True)
    for material in materials:
        tree = material.node_tree
        source = _principled(material).inputs[name]
        emission = tree.nodes.new("ShaderNodeEmission")
        if source.links:
            tree.links.new(source.links[0].from_socket, emission.inputs["Color"])
        else:
            value = source.default_value
            emission.inputs["Color"].default_value = (value,) * 3 + (1.0,) if source.type == "VALUE" else tuple(value)
        output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        canvas = tree.nodes.new("ShaderNodeTexImage")
        canvas.image = target
        tree.nodes.active = canvas
    target.pixels.foreach_set(np.zeros(size * size * 4, dtype=np.float32))
    # Clearing would set alpha to 1, by which the baked texels are told. Blender's report "not saved" is not shown.
    with contextlib.redirect_stdout(None):
        bpy.ops.object.bake(type="EMIT", margin=0, use_clear=False)
    pixels = np.empty(size * size * 4, dtype=np.float32)
    target.pixels.foreach_get(pixels)
    pixels = pixels.reshape(size, size, 4)[::-1]  # Blender's images start at the bottom
    return dilate(pixels[..., :3], pixels[..., 3] > 0.5)


def write_textures(folder: Path, textures: dict[str, NDArray[np.float32]], *, metal: bool) -> None:
    """Write albedo.webp (8-bit sRGB, lossless: three quarters of a PNG), roughness.png and, of metal, metallic.png (8-bit linear).

    Raises:
        RuntimeError: if a value is outside the range that the benchmark's objects keep.
    """
    for name, (low, high) in RANGE.items():
        values = textures[name]
        if values.min() < low - 0.005 or values.max() > high + 0.005:
            raise RuntimeError(f"{name} must lie in [{low}, {high}], found {values.min():.3f} to {values.max():.3f}")
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(encode_srgb(textures["colour"]) * 255).astype(np.uint8)).save(
        folder / "albedo.webp", lossless=True, quality=100, method=6
    )
    for name in ("roughness", "metallic") if metal else ("roughness",):
        Image.fromarray(np.round(textures[name] * 255).astype(np.uint8)).save(folder / f"{name}.png", optimize=True)


def textured_material(folder: Path) -> bpy.types.Material:
    """The one material of a scene: a Principled BSDF fed by the two or three textures, with AOVs for the truth passes.

    Textures are decoded to linear before Cycles sees them, so it interpolates linear values, as a renderer that
    stores linear textures does (Cycles interpolates 8-bit sRGB textures before decoding them).
    """
    material = bpy.data.materials.new("object")
    material.use_nodes = True
    tree = material.node_tree
    shader = _principled(material)
    shader.distribution = "GGX"
    for name, value in (("IOR", IOR), ("Metallic", 0.0), ("Specular IOR Level", 0.5), ("Diffuse Roughness", 0.0)):
        shader.inputs[name].default_value = value
    albedo = decode_srgb(np.asarray(Image.open(folder / "albedo.webp")) / 255)
    values = {"albedo": _texture(tree, "albedo", albedo).outputs["Color"]}
    tree.links.new(values["albedo"], shader.inputs["Base Color"])
    for name in ("roughness", "metallic"):
        if (folder / f"{name}.png").exists():  # a dielectric object has no metallic.png
            grey = np.asarray(Image.open(folder / f"{name}.png"))[..., None].repeat(3, axis=2) / 255
            values[name] = _texture(tree, name, grey).outputs["Color"]
            tree.links.new(values[name], shader.inputs[name.capitalize()])
    add_aovs(material, values)
    return material


def add_aovs(material: bpy.types.Material, values: dict[str, bpy.types.NodeSocket]) -> None:
    """Write `values`, the shading normal (world space) and the depth along the camera's axis to AOVs of their names."""
    tree = material.node_tree
    normal = tree.nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    depth = tree.nodes.new("ShaderNodeCameraData").outputs["View Z Depth"]
    for name, socket in (values | {"normal": normal, "depth": depth}).items():
        aov = tree.nodes.new("ShaderNodeOutputAOV")
        aov.aov_name = name
        tree.links.new(socket, aov.inputs["Color" if name in ("albedo", "normal") else "Value"])


def _texture(tree: bpy.types.NodeTree, name: str, image: NDArray[np.floating]) -> bpy.types.ShaderNode:
    height, width, _ = image.shape
    data = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True, is_data=True)
    data.use_half_precision = False
    rgba = np.concatenate([image[::-1], np.ones((height, width, 1))], axis=-1)
    data.pixels.foreach_set(rgba.astype(np.float32).ravel())
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = data, "Linear", "EXTEND"
    return node
