"""Scanned and artist-made objects, glTF files of `make real-data`, in the place of objects that are modelled in code."""

from pathlib import Path

import bpy
import numpy as np
from materials import RANGE
from numpy.typing import NDArray

# isort: split
from mathutils import Matrix, Vector  # can be imported only once bpy is

RADIUS = 0.98
"""Of the sphere around the origin that holds the object."""


def build(path: Path) -> None:
    """Leave the object of a glTF file in the scene, centred, z up, without relief that its triangles do not have."""
    bpy.ops.import_scene.gltf(filepath=str(path))
    parts = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    bpy.context.view_layer.update()
    corners = np.concatenate([[part.matrix_world @ vertex.co for vertex in part.data.vertices] for part in parts])
    centre = (corners.min(0) + corners.max(0)) / 2
    scale = RADIUS / np.linalg.norm(corners - centre, axis=1).max()
    place = Matrix.Scale(scale, 4) @ Matrix.Translation(-Vector(centre))
    for part in parts:
        world = place @ part.matrix_world
        part.parent = None
        part.matrix_world = world
    for material in {slot.material for part in parts for slot in part.material_slots}:
        _flatten(material)


def _flatten(material: bpy.types.Material) -> None:
    """Keep the base colour, the roughness and metallic of a material: all else would be no texture of the benchmark."""
    tree = material.node_tree
    for node in list(tree.nodes):
        if node.bl_idname in ("ShaderNodeNormalMap", "ShaderNodeGroup"):
            tree.nodes.remove(node)
        elif node.bl_idname == "ShaderNodeBsdfPrincipled":
            for name in ("Normal", "Alpha", "Emission Color", "Emission Strength", "Transmission Weight", "Coat Weight"):
                for link in list(node.inputs[name].links):
                    tree.links.remove(link)
            node.inputs["Alpha"].default_value, node.inputs["Emission Strength"].default_value = 1.0, 0.0
            node.inputs["Transmission Weight"].default_value = node.inputs["Coat Weight"].default_value = 0.0


def within_range(textures: dict[str, NDArray[np.float32]], *, metal: bool) -> dict[str, NDArray[np.float32]]:
    """The textures cut to RANGE, with a line that says how much of each was outside, and how much metal a dielectric loses."""
    if not metal:
        print(f"metallic: the texture's mean of {textures['metallic'].mean():.4f} is taken for 0", flush=True)
    for name, (low, high) in RANGE.items():
        outside = np.mean((textures[name] < low) | (textures[name] > high))
        print(f"{name}: {outside:.1%} of the texture's values cut to [{low}, {high}]", flush=True)
    return textures | {name: textures[name].clip(low, high) for name, (low, high) in RANGE.items()}
