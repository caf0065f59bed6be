"""Writer of the native scene folder (datasets/README.md): whatever is known of a scene, with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.readers.writers.frames import frame_of, lens_of
from ia_bench.readers.writers.parts import Options, flat, save_exr, save_json, save_png
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Mesh, Scene

KNOWN = ("albedo", "roughness", "specular", "normal", "depth")
VERTEX = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_native(folder: Path, scene: Scene) -> Options:
    """OpenEXR of whole floats; textures in 8 bits, where they belong to the mesh that is written."""
    for split in ("train", "test", "novel"):
        frames, views = [], getattr(scene, split)
        unique = len({(view.light, flat(view.name)) for view in views}) == len(views)
        for number, view in enumerate(views):
            name = flat(view.name) if unique else f"{number:04}"
            name = name if view.light == "train" else f"{view.light}/{name}"
            write_exr(folder / f"images/{split}/{name}.exr", np.dstack([view.image, view.mask]), half=False)
            more = dict[str, Any](light=view.light)
            for kind in KNOWN:
                values = getattr(view, kind)
                if values is not None:
                    more[f"{kind}_path"] = f"truth/{split}/{kind}/{name}.exr"
                    write_exr(folder / more[f"{kind}_path"], values, half=False)
            frames.append(frame_of(view, f"images/{split}/{name}.exr", **lens_of(view.camera), **more))
        if frames:
            save_json(folder / f"transforms_{split}.json", {"frames": frames})
    lights, textures = dict[str, str](), dict[str, str]()
    if scene.truth is not None:
        for name, radiance in scene.truth.lights.items():
            lights[name] = f"lights/{name}.exr"
            save_exr(folder / lights[name], radiance)
        for name in ("albedo", "roughness"):
            texture = getattr(scene.truth, name)
            if texture is not None and scene.truth.mesh is None:
                textures[name] = f"truth/{name}.png"
                save_png(folder / textures[name], linear_to_srgb(texture.clip(0, 1)) if name == "albedo" else texture)
    if scene.mesh is not None:
        _save_ply(folder / "mesh.ply", scene.mesh)
    about = {"schema": 1, "name": scene.name, "up": "z", "color_space": "linear_rec709", "metallic": scene.metallic}
    save_json(folder / "scene.json", {**about, "lights": lights, "truth_textures": textures})
    return {}


def _save_ply(path: Path, mesh: Mesh) -> None:
    counts = len(mesh.vertices), len(mesh.faces)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {counts[0]}\n{VERTEX}"
    head += f"element face {counts[1]}\nproperty list uchar int vertex_indices\nend_header\n"
    faces = np.zeros(counts[1], TRIANGLE)
    faces["count"], faces["corners"] = 3, mesh.faces
    vertices = np.concatenate([mesh.vertices, mesh.normals, mesh.uv], 1).astype("<f4")
    path.write_bytes(head.encode() + vertices.tobytes() + faces.tobytes())
