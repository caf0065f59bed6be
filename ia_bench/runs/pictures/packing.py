"""Pack pictures into what a page from disk can use: sheets as WebP, errors as numbers within a script, the object for a viewer."""

from __future__ import annotations

import base64
import gzip
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.runs.assets import glb
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Mesh

TILE = 128  # pixels along a side of a picture on a sheet, at most
ERROR_TILE = 64  # the same of an error, which is a mean over what a pixel of it covers
COLUMNS = 5
LEVELS = 48  # of an error, evenly spaced in its square root
LARGEST = 0.5  # error that the last level stands for
OUTSIDE = 255  # a pixel of an error map that is not scored
PICTURE_QUALITY = 64
EFFORT = 75  # of a lossless picture: 100 takes twelve times as long for 4 % fewer bytes
SMALL = 64  # pixels along a side of a picture that would lose its colours, which a lossy WebP halves in size
TEXTURE, TEXTURE_QUALITY = 256, 50  # texels along a side
STEPS = {"vertices": 2**13, "normals": 2**7, "uv": 2**12}  # a unit is divided into that many: finer than a pixel of the viewer
LIGHT_ROWS = 32


# ---- pictures and errors ----


def sheet(pictures: Sequence[np.ndarray]) -> bytes:
    """Pictures of one shape (H, W, 3) in [0, 1], in rows of COLUMNS, as one WebP; a picture is at most TILE pixels high."""
    tiles = [_smaller(Image.fromarray(np.round(255 * picture).astype(np.uint8))) for picture in pictures]
    width, height = tiles[0].size
    columns = min(COLUMNS, len(tiles))
    whole = Image.new("RGB", (columns * width, -(-len(tiles) // columns) * height))
    for place, tile in enumerate(tiles):
        whole.paste(tile, (place % columns * width, place // columns * height))
    return webp(whole, quality=PICTURE_QUALITY, lossless=height <= SMALL)


def error_map(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root of the mean squared difference over channels and over the scored pixels that a coarser pixel covers.

    Args:
        predicted: (S, S, C) in [0, 1].
        true: The same.
        mask: (S, S), True where scored.

    Returns:
        (s, s) levels from 0 to LEVELS - 1, OUTSIDE where nothing is scored; s is S over the least whole number that
        makes it no more than ERROR_TILE.
    """
    squares = ((predicted - true) ** 2).mean(-1) * mask
    step = -(-len(mask) // ERROR_TILE)
    over = -len(mask) % step
    blocks = [np.pad(part, ((0, over), (0, over))).reshape((len(mask) + over) // step, step, -1, step) for part in (squares, mask)]
    total, count = (part.sum((1, 3)) for part in blocks)
    error = np.sqrt(total / np.maximum(count, 1))
    levels = np.round((LEVELS - 1) * np.sqrt(error.clip(0, LARGEST) / LARGEST))
    return np.where(count > 0, levels, OUTSIDE).astype(np.uint8)


def error_sheet(maps: Sequence[np.ndarray]) -> str:
    """Error maps below each other as a lossless WebP, for a script: a page from disk may not read pixels of other files."""
    return _data_url(webp(Image.fromarray(np.concatenate(maps)), lossless=True))


def webp(image: Image.Image, *, quality: int = EFFORT, lossless: bool = False) -> bytes:
    """A WebP; the ``quality`` of a lossless one is the effort that the encoder makes."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=quality, lossless=lossless, method=6, exact=False)
    return buffer.getvalue()


# ---- the object for the 3-D viewer: its mesh once a scene, textures once a run, lights as Radiance HDR ----


def solid(mesh: Mesh) -> str:
    """The mesh as a glTF binary without textures, compressed by gzip, in base 64; rounded, since rounded numbers compress."""
    parts = {name: (np.round(getattr(mesh, name) * steps) / steps).astype(np.float32) for name, steps in STEPS.items()}
    parts["vertices"] = parts["vertices"] + np.float32(0)  # no negative zeros
    blank = np.ones((1, 1), np.float32)
    return base64.b64encode(gzip.compress(glb(replace(mesh, **parts), np.ones((1, 1, 3), np.float32), blank), mtime=0)).decode()


def textures(albedo: np.ndarray, roughness: np.ndarray) -> dict[str, str]:
    """Linear textures (T, T, 3) and (T, T) as addresses of pictures: albedo in sRGB, roughness as it is."""
    grey = np.broadcast_to(roughness.clip(0, 1)[..., None], (*roughness.shape, 3))
    return {"albedo": _texture(linear_to_srgb(albedo.clip(0, 1))), "roughness": _texture(grey)}


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


# ---- text ----


def compact(content: object) -> str:
    """JSON without a blank that nobody reads."""
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def script(name: str, content: dict[str, Any]) -> bytes:
    """A script that hands ``content`` to the page under a name."""
    return f"bench.receive({compact(name)},{compact(content)});\n".encode()


def _data_url(content: bytes) -> str:
    """A WebP as an address that needs no file."""
    return f"data:image/webp;base64,{base64.b64encode(content).decode()}"


def _texture(shown: np.ndarray) -> str:
    picture = Image.fromarray(np.round(255 * shown).astype(np.uint8))
    if picture.width > TEXTURE:
        picture = picture.resize((TEXTURE, TEXTURE), Image.Resampling.BOX)
    return _data_url(webp(picture, quality=TEXTURE_QUALITY))


def _smaller(picture: Image.Image) -> Image.Image:
    """At most TILE pixels high; a wide one keeps its shape."""
    if picture.height <= TILE:
        return picture
    return picture.resize((round(picture.width * TILE / picture.height), TILE), Image.Resampling.LANCZOS)
