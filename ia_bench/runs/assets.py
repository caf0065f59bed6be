"""What a run leaves for other programs: EXR maps and a glTF binary that any viewer opens."""

from __future__ import annotations

from ia_bench.render.asset_files import glb
from ia_bench.render.reconstruction import Reconstruction
from ia_bench.runs.folder import RunFolder
from ia_bench.scenes.exr import write_exr


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
