"""What views are dressed in and lit by: a bank of textures, one of lights and one of colours, decoded and filtered once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from PIL import Image
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.light.environment import turned
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.exr import read_light
from ia_bench_training.draws import rotation
from ia_bench_training.fits.scene import light_map
from ia_bench_training.lights import HEIGHT, WIDTH, draw_light
from ia_bench_training.objects import tilt
from ia_bench_training.palettes import palette
from ia_bench_training.real_sources import expect_open
from ia_bench_training.textures import draw_material
from ia_bench_training.world.layout import ATLAS, TILE

ROUGHNESS = {
    "Metal": 0.35, "CorrugatedSteel": 0.4, "DiamondPlate": 0.4, "Foil": 0.25, "Chainmail": 0.4, "Tiles": 0.3, "Marble": 0.25,
    "Onyx": 0.2, "Porcelain": 0.15, "GlazedTerracotta": 0.2, "Plastic": 0.4, "Paint": 0.4, "SolarPanel": 0.2, "Granite": 0.4,
    "Terrazzo": 0.35, "Travertine": 0.4, "Wood": 0.5, "WoodFloor": 0.45, "Planks": 0.6, "Bamboo": 0.5, "Rubber": 0.6,
    "Paper": 0.7, "Wallpaper": 0.65, "Cardboard": 0.8, "Clay": 0.7, "Tatami": 0.7,
}  # fmt: skip
"""The mean roughness of a class of textures that has none of its own; all others are matt, MATT."""
MATT = 0.85
METALS = ("Metal", "CorrugatedSteel", "DiamondPlate", "Foil", "Chainmail")
CARDS = 3  # coloured neighbours at most
VARIANTS = 4  # of every photographed light: as it is, then turned, with a ground or neighbours of other colours


# ---------------------------------------------------------------- textures
def procedural_tile(rng: Generator) -> np.ndarray:
    """A procedural material on a square of side 2: (TILE, TILE, 5) uint8 as in :func:`real_tiles`."""
    line = (torch.arange(TILE) + 0.5) / TILE * 2 - 1
    place = torch.stack([*torch.meshgrid(line, line, indexing="xy"), torch.full((TILE, TILE), float(rng.uniform(-1, 1)))], -1)
    albedo, roughness = draw_material(rng, palette(rng, 5))(place.reshape(-1, 3), torch.full((TILE**2,), 2))
    values = np.concatenate([linear_to_srgb(albedo.numpy()), roughness.numpy(), np.zeros((TILE**2, 1))], 1)
    return np.rint(255 * values).astype(np.uint8).reshape(TILE, TILE, 5)


def real_tiles(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """The open textures below ``folder``/textures: (N, TILE, TILE, 5) uint8, and the chance (N,) that each is drawn.

    Channels are sRGB, then roughness and metallic, linear. Of a class of n maps each has a chance of n^-1/2.
    """
    tiles, chances = [], []
    for place in sorted((folder / "textures/ambientcg_128").iterdir()):
        rough, paths = ROUGHNESS.get(place.name, MATT), sorted(place.iterdir())
        for path in paths:
            rest = [np.full((TILE, TILE, 1), 255 * value) for value in (rough, place.name in METALS)]
            tiles.append(np.concatenate([_picture(expect_open(path), "RGB"), *rest], -1))
            chances.append(len(paths) ** -0.5)
    for place in sorted((folder / "textures/pbr").iterdir()):
        colour = _picture(expect_open(next(place.glob("albedo.*"))), "RGB", 4 * TILE)
        rest = [np.full((*colour.shape[:2], 1), 255 * value) for value in (MATT, 0.0)]
        for channel, name in enumerate(("roughness", "metallic")):
            for known in place.glob(f"{name}.*"):
                rest[channel] = _picture(expect_open(known), "L", 4 * TILE)[..., None]
        whole = np.concatenate([colour, *rest], -1)
        cuts = [(whole, 4), *((whole[r : r + 2 * TILE, c : c + 2 * TILE], 2) for r in (0, 2 * TILE) for c in (0, 2 * TILE))]
        tiles += [cut.reshape(TILE, step, TILE, step, 5).mean((1, 3)) for cut, step in cuts]
        chances += [0.5] * len(cuts)
    return np.stack(tiles).round().astype(np.uint8), np.array(chances)


def _picture(path: Path, mode: str, side: int = TILE) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert(mode).resize((side, side), Image.Resampling.BICUBIC), np.float32)


def atlas(albedo: np.ndarray, roughness: np.ndarray, metallic: np.ndarray | None) -> np.ndarray:
    """The textures of a real mesh as (ATLAS, ATLAS, 5) uint8; a roughness of one value is none: 0."""
    planes = [linear_to_srgb(albedo.clip(0, 1)), roughness[..., None] if roughness.size > 1 else np.zeros((1, 1, 1))]
    planes.append(np.zeros((1, 1, 1)) if metallic is None else metallic[..., None])
    codes = [np.rint(255 * plane[..., k]).astype(np.uint8) for plane in planes for k in range(plane.shape[2])]
    return np.stack([np.asarray(Image.fromarray(code).resize((ATLAS, ATLAS), Image.Resampling.BOX)) for code in codes], -1)


def packed(tiles: np.ndarray, levels: int) -> dict[str, Tensor]:
    """Square textures (N, T, T, 5) uint8 and their means of 2 x 2 texels, ``levels`` in all, as Bank takes them."""
    count, decode = len(tiles), srgb_to_linear(np.arange(256, dtype=np.float32) / 255)
    flat, mean, current = [tiles.reshape(-1, 5)], np.empty((count, 5), np.float32), tiles
    for level in range(levels):
        parts = []
        for first in range(0, count, 64):  # linear, or means would be dark
            chunk = current[first : first + 64]
            linear = np.concatenate([decode[chunk[..., :3]], chunk[..., 3:] / np.float32(255)], -1)
            if level == levels - 1:
                mean[first : first + 64] = linear.mean((1, 2))
                continue
            small = linear.reshape(len(chunk), chunk.shape[1] // 2, 2, chunk.shape[1] // 2, 2, 5).mean((2, 4))
            small[..., :3] = linear_to_srgb(small[..., :3])
            parts.append(np.rint(255 * small).astype(np.uint8))
        if parts:
            current = np.concatenate(parts)
            flat.append(current.reshape(-1, 5))
    return {"flat": torch.from_numpy(np.concatenate(flat)), "mean": torch.from_numpy(mean)}


# ---------------------------------------------------------------- lights
def photographed(path: Path, rng: Generator) -> list[Tensor]:
    """VARIANTS of an open photographed light, (HEIGHT, WIDTH, 3) each."""
    whole = read_light(expect_open(path))
    step = whole.shape[0] // HEIGHT
    if step < 1:
        raise InputError(f"{path}: expected a map of {HEIGHT} rows or more, found {whole.shape[0]}")
    kept = [_reduced(whole, step)]
    for number in range(1, VARIANTS):
        turn = rotation(rng) if number == 1 else tilt(rng, 0.2)
        kept.append(_neighbours(_reduced(turned(whole, turn), step), rng, ground=number == 3))
    return kept


def procedural_light(rng: Generator) -> Tensor:
    """A light of the generator, (HEIGHT, WIDTH, 3), at times with neighbours."""
    radiance = light_map(draw_light(rng), HEIGHT)
    return _neighbours(radiance, rng, ground=False) if rng.random() < 0.4 else radiance


def _reduced(radiance: np.ndarray, step: int) -> Tensor:
    return torch.from_numpy(radiance.reshape(HEIGHT, step, WIDTH, step, 3).mean((1, 3)))


def _neighbours(radiance: Tensor, rng: Generator, *, ground: bool) -> Tensor:
    """Objects and a ground beside what is lit: they hide the light behind them and throw back some of their own colour."""
    around, area = texel_centres(HEIGHT, WIDTH), row_solid_angles(HEIGHT, WIDTH).float()[:, None, None]
    mean = (radiance * area).sum((0, 1)) / (4 * math.pi)
    colours = torch.from_numpy(palette(rng, CARDS + 1)).float()
    if ground:
        up = (radiance * around[..., 2:].clamp_min(0) * area).sum((0, 1)) / math.pi
        soft = (0.5 - around[..., 2:] * 12).clamp(0, 1)
        radiance = radiance * (1 - soft) + soft * colours[-1] * up
    for number in range(int(rng.integers(0, CARDS + 1))):
        toward = torch.from_numpy(rotation(rng)[0]).float()
        edge = math.cos(rng.uniform(0.2, 0.7))
        inside = ((around @ toward - edge) * 15 + 0.5).clamp(0, 1)[..., None]
        radiance = radiance * (1 - inside) + inside * colours[number] * mean * rng.uniform(0.4, 1.2)
    return radiance
