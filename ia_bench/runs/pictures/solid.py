"""The object for the 3-D viewer: its mesh once a scene, textures once a run, lights as Radiance HDR."""

from __future__ import annotations

import base64
import gzip
from dataclasses import replace

import numpy as np
from PIL import Image

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.runs.assets import glb
from ia_bench.runs.pictures.packing import data_url, webp
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Mesh

TEXTURE = 256  # texels along a side
TEXTURE_QUALITY = 50
STEPS = {"vertices": 2**13, "normals": 2**7, "uv": 2**12}  # a unit is divided into that many: finer than a pixel of the viewer
LIGHT_ROWS = 32


def solid(mesh: Mesh) -> str:
    """The mesh as a glTF binary without textures, compressed by gzip, in base 64; rounded, since rounded numbers compress."""
    parts = {name: (np.round(getattr(mesh, name) * steps) / steps).astype(np.float32) for name, steps in STEPS.items()}
    parts["vertices"] = parts["vertices"] + np.float32(0)  # no negative zeros
    blank = np.ones((1, 1), np.float32)
    return base64.b64encode(gzip.compress(glb(replace(mesh, **parts), np.ones((1, 1, 3), np.float32), blank), mtime=0)).decode()


def texture(image: np.ndarray, *, encoded: bool) -> str:
    """A texture (T, T, 3) or (T, T), linear, as an address; ``encoded``: by the sRGB curve."""
    shown = linear_to_srgb(image.clip(0, 1)) if encoded else np.broadcast_to(image.clip(0, 1)[..., None], (*image.shape, 3))
    picture = Image.fromarray(np.round(255 * shown).astype(np.uint8))
    if picture.width > TEXTURE:
        picture = picture.resize((TEXTURE, TEXTURE), Image.Resampling.BOX)
    return data_url("image/webp", webp(picture, quality=TEXTURE_QUALITY))


def light(environment: LatLongEnvironment) -> str:
    """A light as a Radiance HDR picture in base 64, laid out as glTF viewers do: y is up, and +x lies in the middle."""
    import torch

    rows, columns = LIGHT_ROWS, 2 * LIGHT_ROWS
    up = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    around = 2 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    elevation, azimuth = np.meshgrid(up, around, indexing="ij")
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)
    directions = torch.from_numpy(np.stack([x, -z, y], -1).reshape(-1, 3)).float()  # the viewer's y is our z
    small = LatLongEnvironment(environment.latlong(min(LIGHT_ROWS, environment.texels.shape[0])))
    return base64.b64encode(hdr(small.radiance(directions).reshape(rows, columns, 3).numpy())).decode()


def hdr(image: np.ndarray) -> bytes:
    """A Radiance picture (RGBE, not run-length encoded) of linear values (H, W, 3) >= 0.

    A texel is m 2^(e - 136) with bytes m of each channel and one e: G. Ward, "Real Pixels", Graphics Gems II (1991).
    """
    height, width, _ = image.shape
    brightest = image.max(-1)
    _, exponents = np.frexp(brightest)  # brightest = f 2^e with f in [.5, 1)
    scale = np.where(brightest > 0, np.ldexp(256.0, -exponents), 0.0)
    texels = np.zeros((height, width, 4), np.uint8)
    texels[..., :3] = np.floor(image * scale[..., None]).clip(0, 255)
    texels[..., 3] = np.where(brightest > 0, exponents + 128, 0).clip(0, 255)
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode() + texels.tobytes()
