"""Scenes on which a method is at home: photographs that its own renderer took of a known material under a known light."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.checks.methods import Memory
from ia_bench.light.latlong import texel_centres
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Method, Problem
from ia_bench.render.reconstruction import Quality, Reconstruction
from ia_bench.render.settings import RenderSettings
from ia_bench.scenes.scene import Scene

RENDER = RenderSettings(samples=16, texture=64, light_height=16)
QUALITY = Quality(points=2, samples=512)


def smooth_light(rows: int = 16) -> Tensor:
    """A bluish sky with three soft lamps of different colours, (rows, 2 rows, 3)."""
    direction = texel_centres(rows, 2 * rows)
    lamps = [
        ((0.5, 0.3, 0.8), 20.0, (4.0, 3.6, 3.0)),
        ((-0.7, 0.2, 0.4), 8.0, (0.6, 1.0, 1.6)),
        ((0.1, -0.9, 0.2), 12.0, (1.8, 1.2, 1.4)),
    ]
    light = torch.tensor([0.25, 0.28, 0.33]) * (1.5 + direction[..., 2:]) / 2
    for axis, sharpness, colour in lamps:
        cosine = direction @ torch.nn.functional.normalize(torch.tensor(axis), dim=0)
        light = light + torch.exp(sharpness * (cosine[..., None] - 1)) * torch.tensor(colour)
    return light


def smooth_material(size: int = 64, *, metallic: bool = False) -> Material:
    """Slow waves of albedo, whose mean is grey, and of roughness between .3 and .7; ``metallic``: with a texture that is 0."""
    line = (torch.arange(size) + 0.5) / size * 2 * math.pi
    v, u = torch.meshgrid(line, line, indexing="ij")
    waves = [torch.sin(2 * u) * torch.cos(v), torch.sin(v + 2) * torch.cos(2 * u), torch.cos(2 * v) * torch.sin(u + 1)]
    albedo = 0.45 + 0.3 * torch.stack(waves, -1)
    roughness = 0.5 + 0.2 * torch.sin(u + v)[..., None]
    return Material(albedo, roughness, torch.zeros(size, size, 1) if metallic else None)


def photographed(scene: Scene, taken: Reconstruction) -> Scene:
    """The same cameras, all photographs taken by the renderer of ``taken`` under its own light; masks are its coverage."""
    images = taken.render([view.camera for view in scene.train], light=None, albedo_scale=None, quality=QUALITY)
    shown = zip(scene.train, images.images, images.coverage, strict=True)
    return replace(scene, train=tuple(replace(view, image=image.astype(np.float32), mask=mask) for view, image, mask in shown))


def problem_of(scene: Scene) -> Problem:
    """What a run would hand to a method."""
    return Problem(scene.blind(), RENDER, note=lambda _: None)


def check_recovered(method: Method, truth: Reconstruction, scene: Scene, *, albedo: float, roughness: float) -> None:
    """Fit photographs that ``truth`` took with the cameras of ``scene``, and look inside the object with its test cameras.

    ``albedo``: the least PSNR after one scale for all, dB; ``roughness``: the largest mean squared error.
    """
    found = method.fit(problem_of(photographed(scene, truth)), seed=0, monitor=Memory().monitor()).reconstruction
    cameras = [view.camera for view in scene.test]
    its, true = (one.maps(cameras, ("albedo", "roughness"), points=4) for one in (found, truth))
    inside = np.concatenate([cover.ravel() for cover in true["albedo"].coverage]) > 0.999
    colours, reference = (np.concatenate([image.reshape(-1, 3) for image in maps["albedo"].images])[inside] for maps in (its, true))
    scale = (colours * reference).sum() / np.square(colours).sum()
    psnr = -10 * np.log10(np.square(scale * colours - reference).mean())
    rough = [np.concatenate([image.ravel() for image in maps["roughness"].images])[inside] for maps in (its, true)]
    error = np.square(rough[0] - rough[1]).mean()
    assert psnr >= albedo, (psnr, error)
    assert error <= roughness, (psnr, error)
