"""How light is compared with light: by balls that it shines on, and by the log of its radiance.

Images under unknown light leave one factor open, and each channel's is the light's colour, which counts. So both lights are
first divided by their mean over the sphere and the channels. As LeGendre et al. (2019, "DeepLight") compare lights, a mirror
ball, a glossy and a matt one stand under each: the first shows where the light comes from, the last how it falls on things.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.brdf import microfacets
from ia_bench.scenes.images import Images
from ia_bench.scores.metrics import Undefined

SIDE = 32  # pixels of a ball's picture
SIDES = 4  # from which each ball is seen, a quarter turn apart: half of the sphere lies behind a matt ball
ROWS = 32  # of the map whose texels light the glossy and the matt ball
MIRROR_ROWS = 64  # of the map that the mirror shows
GLOSSY = 0.4  # perceptual roughness
EXPOSURE = 0.5  # a white matt ball is grey on average, and a lamp four times as bright as the mean is clipped
DARKEST = 1e-3  # of the mean radiance: what is darker counts as that in the log


def of_mean_one(light: Environment, rows: int) -> Tensor:
    """The map (rows, 2 rows, 3) of a light, divided by its mean over the sphere and the channels. Raises Undefined for black."""
    texels = light.latlong(rows).double().cpu()
    mean = (texels.mean((1, 2)) * row_solid_angles(rows, 2 * rows)).sum() * 2 * rows / (4 * math.pi)
    if not float(mean) > 0 or not torch.isfinite(mean):
        raise Undefined(f"the light's mean radiance is {float(mean):g}")
    return texels / mean


def ball_pictures(light: Environment) -> Images:
    """SIDES orthographic pictures each of a mirror ball, a glossy and a matt one, premultiplied, all white (reflectance 1)."""
    texels, mirrored = of_mean_one(light, ROWS), LatLongEnvironment(of_mean_one(light, MIRROR_ROWS))
    power = (texels * row_solid_angles(ROWS, 2 * ROWS)[:, None, None]).reshape(-1, 3).float()
    inside, seen = _balls()
    towards = texel_centres(ROWS, 2 * ROWS).reshape(-1, 3).T
    shown = [EXPOSURE * mirrored.radiance(reflected) for _, reflected, _ in seen]
    shown += [EXPOSURE * (glossy @ power) for *_, glossy in seen]
    shown += [EXPOSURE * (normal @ towards).clamp_min(0) @ power / math.pi for normal, *_ in seen]
    pictures = torch.zeros(len(shown), SIDE, SIDE, 3)
    for picture, values in zip(pictures, shown, strict=True):
        picture[inside] = values.float()
    return Images(tuple(pictures.numpy()), (inside.float().numpy(),) * len(shown))


@functools.cache
def _balls() -> tuple[Tensor, list[tuple[Tensor, Tensor, Tensor]]]:
    """Which pixels of a picture show the ball, (SIDE, SIDE) bool, and what these P pixels show from each side.

    That is the normal (P, 3); where the mirror looks (P, 3); and the glossy ball's BRDF times the cosine, for light from each of
    the T texels, per steradian (P, T).
    """
    line = (torch.arange(SIDE) + 0.5) / SIDE * 2 - 1
    up, right = torch.meshgrid(-line, line, indexing="ij")
    inside = up.square() + right.square() < 1
    up, right = up[inside], right[inside]
    toward = (1 - up.square() - right.square()).sqrt()
    directions, roughness = texel_centres(ROWS, 2 * ROWS).reshape(-1, 3), torch.full((1, 1, 1), GLOSSY)
    seen = []
    for side in range(SIDES):
        turn = 2 * math.pi * side / SIDES
        view = torch.tensor([math.cos(turn), math.sin(turn), 0.0])
        across = torch.tensor([-math.sin(turn), math.cos(turn), 0.0])
        normal = toward[:, None] * view + right[:, None] * across
        normal[:, 2] = up
        lobe = microfacets(normal[:, None], view, directions, roughness)[0][..., 0]
        seen.append((normal, 2 * toward[:, None] * normal - view, lobe))
    return inside, seen


def log_radiance(light: Environment) -> Images:
    """The natural log of the radiance, (ROWS, 2 ROWS, 3), on rows of equal height: every pixel has the same solid angle."""
    height = 1 - (torch.arange(ROWS, dtype=torch.float64) + 0.5) * (2 / ROWS)
    around = math.pi - (torch.arange(2 * ROWS, dtype=torch.float64) + 0.5) * (math.pi / ROWS)
    radius = (1 - height.square()).sqrt()[:, None]
    x, y = radius * torch.cos(around), radius * torch.sin(around)
    directions = torch.stack([x, y, height[:, None].expand_as(x)], -1)
    radiance = LatLongEnvironment(of_mean_one(light, ROWS)).radiance(directions.reshape(-1, 3)).reshape(ROWS, 2 * ROWS, 3)
    picture = radiance.clamp_min(DARKEST).log().float().numpy()
    return Images((picture,), (torch.ones(ROWS, 2 * ROWS).numpy(),))
