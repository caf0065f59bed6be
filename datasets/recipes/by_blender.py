"""What tests/render/by_blender.glb was made with: python by_blender.py FILE.glb, with bpy 4.5.15 (requirements.txt has it).

Two objects and two materials: a sphere with pictures of base colour and of roughness (green) and metallic (blue), and a plain cube.
"""

import sys

import bpy
import numpy as np

rng = np.random.default_rng(0)


def picture(name: str, space: str) -> bpy.types.Image:
    """One of random texels."""
    image = bpy.data.images.new(name, 8, 8, alpha=False)
    image.colorspace_settings.name = space
    image.pixels = np.dstack([rng.integers(0, 256, (8, 8, 3)) / 255, np.ones((8, 8))]).ravel().tolist()
    image.pack()
    return image


def material(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree, bpy.types.Node]:
    """A new one, its nodes, and the one of them that shades."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    return made, made.node_tree, made.node_tree.nodes["Principled BSDF"]


bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=6, radius=0.5, location=(0, 0, 0.5))
bpy.ops.object.shade_smooth()
painted, tree, shader = material("painted")
bpy.context.object.data.materials.append(painted)
base, packed = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeTexImage")
base.image, packed.image = picture("base", "sRGB"), picture("packed", "Non-Color")
apart = tree.nodes.new("ShaderNodeSeparateColor")
for source, target in (
    (base.outputs["Color"], shader.inputs["Base Color"]),
    (packed.outputs["Color"], apart.inputs[0]),
    (apart.outputs[1], shader.inputs["Roughness"]),
    (apart.outputs[2], shader.inputs["Metallic"]),
):
    tree.links.new(source, target)
bpy.ops.mesh.primitive_cube_add(size=0.6, location=(0.8, 0.1, 0.3))
plain, _, shader = material("plain")
bpy.context.object.data.materials.append(plain)
shader.inputs["Base Color"].default_value = (0.02, 0.4, 0.1, 1)
shader.inputs["Roughness"].default_value = 0.35
bpy.ops.export_scene.gltf(filepath=sys.argv[-1], export_format="GLB")
