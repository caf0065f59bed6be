"""What a run leaves for other programs: EXR maps and a glTF binary that any viewer opens."""

from __future__ import annotations

import numpy as np
from PIL import Image

from ia_bench.render.reconstruction import Reconstruction
from ia_bench.runs.folder import RunFolder
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Mesh


def write_assets(folder: RunFolder, reconstruction: Reconstruction) -> None:
    """Write albedo.exr (T, T, 3), roughness.exr (T, T), light.exr (H, W, 3), all linear, and asset.glb.

    And metallic.exr (T, T) where it was recovered. Nothing of a reconstruction that has no textures.
    """
    assets = reconstruction.assets()
    if assets is None:
        return
    for name in ("albedo", "roughness", "metallic", "light"):
        image = getattr(assets, name)
        if image is not None:
            with folder.path_for(f"{name}.exr") as path:
                write_exr(path, image, half=False)
    folder.write_bytes("asset.glb", glb(assets.mesh, assets.albedo, assets.roughness, assets.metallic))


def glb(mesh: Mesh, albedo: np.ndarray, roughness: np.ndarray, metallic: np.ndarray | None = None) -> bytes:
    """A glTF 2.0 binary: metallic-roughness material, sRGB base colour, roughness in green, metallic in blue; y-up axes.

    ``albedo`` (T, T, 3); ``roughness`` and ``metallic`` (T', T'), None for a dielectric.
    """
    import trimesh  # most of a second, at the end of a run
    from trimesh.visual.material import PBRMaterial

    base_colour = np.round(255 * linear_to_srgb(albedo.clip(0, 1))).astype(np.uint8)
    packed = np.zeros((*roughness.shape, 3), np.uint8)
    packed[..., 1] = np.round(255 * roughness.clip(0, 1))
    if metallic is not None:
        packed[..., 2] = np.round(255 * metallic.clip(0, 1))
    material = PBRMaterial(
        name="recovered",
        baseColorTexture=Image.fromarray(base_colour),
        metallicRoughnessTexture=Image.fromarray(packed),
        metallicFactor=0.0 if metallic is None else 1.0,
        roughnessFactor=1.0,
    )
    z_up_to_y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64)
    solid = trimesh.Trimesh(
        vertices=mesh.vertices @ z_up_to_y_up.T,
        faces=mesh.faces,
        vertex_normals=mesh.normals @ z_up_to_y_up.T,
        visual=trimesh.visual.TextureVisuals(uv=mesh.uv, material=material),
        process=False,
    )
    return bytes(trimesh.Scene(solid).export(file_type="glb"))
