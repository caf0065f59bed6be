"""Check what the recipes rely on, with a ball: light and camera directions, pass conventions, direct-only light.

    python datasets/recipes/check_conventions.py

Light whose radiance encodes its own direction is reflected by a mirror ball, so every pixel says from where it was lit.
"""

import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from cameras import DISTANCE, FIELD_OF_VIEW, camera_to_world, spherical
from exr import round_mantissa, write_exr
from geometry import to_blender
from latlong import texel_directions
from materials import add_aovs
from mesh import Mesh
from numpy.typing import NDArray
from passes import Passes
from render_scene import quiet
from renderer import Renderer

SIZE, HEIGHT = 48, 128
RADIUS = 0.9


def ball(rows: int = 96) -> Mesh:
    """A sphere with exact normals; its UV is not used."""
    theta = np.pi * np.arange(rows + 1) / rows
    phi = 2 * np.pi * np.arange(2 * rows) / (2 * rows)
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=-1)
    normals = np.sin(theta)[:, None, None] * ring + np.cos(theta)[:, None, None] * np.array([0, 0, 1.0])
    index = np.arange(normals.shape[0] * normals.shape[1]).reshape(normals.shape[:2])
    a, b = index[:-1], index[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    faces = np.concatenate([np.stack([a, b, c], -1)[:-1].reshape(-1, 3), np.stack([a, c, d], -1)[1:].reshape(-1, 3)])
    normals = normals.reshape(-1, 3).astype(np.float32)
    return Mesh(RADIUS * normals, normals, np.zeros((len(normals), 2), np.float32), faces.astype(np.int32))


def render_ball(pose: NDArray[np.float64], light: NDArray[np.floating], mirror: bool, direct_only: bool) -> Passes:
    """The ball under a lat-long light, as a perfect mirror or as white dull plastic."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = to_blender(ball())
    material = bpy.data.materials.new("ball")
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    for name, value in (("Metallic", float(mirror)), ("Roughness", float(not mirror)), ("Base Color", (1, 1, 1, 1))):
        shader.inputs[name].default_value = value
    add_aovs(material, {})
    item.data.materials.append(material)
    renderer = Renderer(SIZE)
    with tempfile.TemporaryDirectory() as folder:
        write_exr(Path(folder) / "light.exr", round_mantissa(light, 10))
        renderer.set_light(Path(folder) / "light.exr")
        return renderer.render(pose, samples=256, direct_only=direct_only)


def pixel_rays(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit directions (SIZE, SIZE, 3) of the rays through the pixel centres, from the OpenGL convention."""
    centres = (np.arange(SIZE) + 0.5) / SIZE * 2 - 1
    x, y = np.meshgrid(centres, -centres)
    camera = np.stack([x, y, np.full_like(x, -1 / np.tan(FIELD_OF_VIEW / 2))], axis=-1)
    return (camera / np.linalg.norm(camera, axis=-1, keepdims=True)) @ pose[:3, :3].T


def main() -> int:
    """Print every check; the exit status is the number of failures."""
    failures = 0

    def report(what: str, error: float, limit: float) -> None:
        nonlocal failures
        failures += not error <= limit  # as NaN is, too
        print(f"{'ok  ' if error <= limit else 'FAIL'} {what}: {error:.4f} (limit {limit})", flush=True)

    directions = texel_directions(HEIGHT)
    for azimuth, elevation in ((0.4, 0.3), (2.5, -0.3), (-1.9, 1.2)):
        pose = camera_to_world(spherical(np.array(azimuth), np.array(elevation)))
        rays = pixel_rays(pose)
        along = rays @ pose[:3, 3]
        inside = along**2 - DISTANCE**2 + RADIUS**2
        core = inside > 0.35 * RADIUS**2  # far from the rim, where a pixel is a wide range of directions
        distance = -along - np.sqrt(np.where(core, inside, 1.0))
        normal = (pose[:3, 3] + distance[..., None] * rays) / RADIUS
        mirrored = rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal
        mirror = render_ball(pose, 1 + directions, mirror=True, direct_only=False)
        seen = mirror.rgba[..., :3] - 1
        seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
        degrees = np.degrees(np.arccos(np.clip((seen * mirrored).sum(-1), -1, 1)))
        report(f"camera at azimuth {azimuth}, elevation {elevation}: light, degrees", degrees[core].max(), 1.0)
        report("  normals", np.abs(mirror.normal - normal)[core].max(), 0.01)
        depth = distance * (rays @ -pose[:3, 2])
        report("  depth along the axis", np.abs(mirror.depth - depth)[core].max(), 0.01)
        area = np.abs(mirror.rgba[..., 3].mean() - (inside > 0).mean())
        report("  coverage of the frame", float(area), 0.01)
    light = np.ones_like(directions)
    once, often = (render_ball(pose, light, mirror=False, direct_only=flag).rgba[core][:, :3] for flag in (True, False))
    report("a convex ball gets no indirect light", float(np.abs(once - often).max()), 1e-3)
    report("white plastic in a white furnace differs from 1", float(np.abs(often - 1).max()), 0.02)
    return failures


if __name__ == "__main__":
    with quiet():
        sys.exit(main())
