"""The Monte-Carlo estimator against closed forms, and against brute force that shares no formula with it.

Against the same in torch, number by number: test_kernels.py.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import norm
from shapes import camera_at, disk, plate, sphere, together
from stage import Stage

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch

pytestmark = pytest.mark.verify

RADIANCE = torch.tensor([0.5, 1.0, 2.0])
ALBEDO = torch.tensor([0.2, 0.5, 0.9])


def constant(roughness: float = 1.0) -> Material:
    return Material(ALBEDO.expand(4, 4, 3).contiguous(), torch.full((4, 4, 1), roughness))


def constant_light(height: int = 8) -> SampledLight:
    return SampledLight.of(RADIANCE.expand(height, 2 * height, 3).contiguous())


# ---------------------------------------------------------------- samples
# ---------------------------------------------------------------- closed forms
def test_shadow_of_a_disk() -> None:
    """A small patch under a coaxial disk: the form factor R^2 / (R^2 + h^2) of its light is blocked."""
    radius, height = 0.7, 0.6
    mesh = together(plate(0.01), disk(radius, height=height))
    camera = camera_at((0.3, 0.0, 0.08), pixels=16, field_of_view=2.0)  # from the side, below the disk
    stage = Stage.of(mesh, [camera])
    patch = torch.nonzero(stage.gbuffer.face[:, 0] < 2)[:, 0]
    assert len(patch) > 50
    arguments = (constant(), constant_light(32), 512, torch.Generator().manual_seed(3))
    shadowed = stage.renderer().render_pixels(stage.gbuffer, patch, *arguments)
    open_sky = 1 - radius**2 / (radius**2 + height**2)
    expected = ALBEDO * RADIANCE * open_sky
    torch.testing.assert_close(shadowed.diffuse.mean(0), expected, rtol=0.01, atol=0)
    lit = stage.renderer(shadows=False).render_pixels(stage.gbuffer, patch, *arguments)
    torch.testing.assert_close(lit.diffuse.mean(0), ALBEDO * RADIANCE, rtol=0.01, atol=0)


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.5])
def test_a_black_light_gives_black(uniform_fraction: float) -> None:
    stage = Stage.of(sphere(1), [camera_at((2.0, -3.0, 1.0), pixels=8)])
    light = SampledLight.of(torch.zeros(4, 8, 3), uniform_fraction=uniform_fraction)
    images = stage.renderer().render_images(stage.gbuffer, constant(), light, 8, torch.Generator().manual_seed(4))
    assert float(images["radiance"].abs().max()) == 0
    assert float(images["albedo"].max()) > 0


# ---------------------------------------------------------------- brute force
FALSE_ALARM = 1e-3
"""Probability that the test below fails for a correct estimator (Sidak over all pixels, channels and parts)."""

DIRECTIONS, REPEATS, PIXELS = 8000, 300, 120


def brute_force(stage: Stage, pixels: torch.Tensor, material: Material, radiance: np.ndarray) -> np.ndarray:
    """Per direction: 4 pi L V f cos for uniform directions, (P, D, 2, 3) diffuse and specular, in numpy float64."""
    points = stage.points(pixels)
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(len(pixels), DIRECTIONS, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    origin = (points.position + stage.surface.offset * points.geometric)[:, None].expand(-1, DIRECTIONS, 3)
    blocked = stage.rays.occluded(origin.reshape(-1, 3).contiguous(), torch.from_numpy(direction).float().reshape(-1, 3))
    normal, view = points.normal.double().numpy()[:, None], points.view.double().numpy()[:, None]
    roughness = fetch(material.roughness, points.uv).double().numpy()
    albedo = fetch(material.albedo, points.uv).double().numpy()[:, None]

    height, width, _ = radiance.shape
    row = np.clip(np.arccos(np.clip(direction[..., 2], -1, 1)) / np.pi * height, 0, height - 1).astype(int)
    phi = np.arctan2(direction[..., 1], direction[..., 0])
    column = np.clip((np.pi - phi) / (2 * np.pi) * width, 0, width - 1).astype(int)

    cos_i, cos_o = (direction * normal).sum(-1), (view * normal).sum(-1)
    half = direction + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h, cos_d = (half * normal).sum(-1), (half * view).sum(-1)
    alpha2 = roughness**4
    tan2_i, tan2_o = 1 / cos_i**2 - 1, 1 / cos_o**2 - 1
    smith = 2 / (np.sqrt(1 + alpha2 * tan2_i) + np.sqrt(1 + alpha2 * tan2_o))
    ggx = alpha2 / (np.pi * (cos_h**2 * (alpha2 - 1) + 1) ** 2)
    specular = ggx * smith * (0.04 + 0.96 * (1 - cos_d) ** 5) / (4 * cos_o)
    visible = (~blocked.numpy().reshape(cos_i.shape) & (cos_i > 0))[..., None]
    incoming = 4 * np.pi * radiance[row, column] * visible
    return np.stack([incoming * albedo / np.pi * cos_i[..., None], incoming * specular[..., None]], 2)


def test_estimator_agrees_with_brute_force(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """z-test per pixel, channel and part of MIS against uniform directions over the sphere, shadows included."""
    radiance = LatLongEnvironment(soft_light).latlong(16)
    light = SampledLight.of(radiance)
    pixels = torch.randperm(len(tiny_stage.gbuffer.pixel), generator=torch.Generator().manual_seed(6))[:PIXELS]
    flat = tiny_stage.points(pixels)
    pixels = pixels[(flat.normal * flat.view).sum(-1) > 0.05]  # brute force has no answer at grazing either
    assert len(pixels) > 0.9 * PIXELS

    wanted = brute_force(tiny_stage, pixels, tiny_material, radiance.double().numpy())
    generator = torch.Generator().manual_seed(7)
    renderer = tiny_stage.renderer()
    found = []
    for _ in range(REPEATS // 20):
        part = renderer.render_pixels(tiny_stage.gbuffer, pixels.repeat(20), tiny_material, light, 16, generator)
        found.append(torch.stack([part.diffuse, part.specular], 1).reshape(20, len(pixels), 2, 3))
    ours = torch.cat(found).double().numpy()

    error = np.sqrt(wanted.var(1, ddof=1) / DIRECTIONS + ours.var(0, ddof=1) / REPEATS)
    difference = ours.mean(0) - wanted.mean(1)
    lit = wanted.mean(1) > 1e-6
    assert lit.mean() > 0.95
    assert np.median((error / wanted.mean(1))[lit]) < 0.05  # so a bias of 25 % in one pixel is seen ...
    z = np.abs(difference / error)[lit]
    limit = norm.isf((1 - (1 - FALSE_ALARM) ** (1 / z.size)) / 2)
    assert z.max() < limit, f"largest |z| {z.max():.2f} of {z.size}, limit {limit:.2f}"
    for part in range(2):  # ... and one of 5 % in all of them: pixels are independent of each other
        total = difference[:, part].mean(-1).sum() / np.sqrt((error[:, part].mean(-1) ** 2).sum())
        assert abs(total) < norm.isf(FALSE_ALARM / 4)
        assert np.sqrt((error[:, part].mean(-1) ** 2).sum()) / wanted[:, :, part].mean((1, 2)).sum() < 0.02


# ---------------------------------------------------------------- convergence
def test_passes_of_a_picture_share_one_lattice(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """Passes of 32 samples: independent ones would halve the error with four times as many, parts of a lattice do better."""
    light = SampledLight.of(soft_light)

    def error(samples: int, seed: int) -> float:
        pair = [
            tiny_stage.renderer().render_images(tiny_stage.gbuffer, tiny_material, light, samples, torch.Generator().manual_seed(s))
            for s in (seed, seed + 1)
        ]
        return float(((pair[0]["radiance"] - pair[1]["radiance"]) ** 2).mean().sqrt())

    assert 0.2 < error(128, 10) / error(32, 12) < 0.45
