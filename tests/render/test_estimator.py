"""The Monte-Carlo estimator against closed forms, and against brute force that shares no formula with it.

Against the same in torch, number by number: test_kernels.py.
"""

from __future__ import annotations

import math

import kernel_calls
import numpy as np
import pytest
import torch
from scipy.stats import norm
from shapes import camera_at, disk, plate, sphere, together
from stage import Stage

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.render.estimator import draw_samples
from ia_bench.render.gbuffer import SurfacePoints

pytestmark = pytest.mark.verify

RADIANCE = torch.tensor([0.5, 1.0, 2.0])
ALBEDO = torch.tensor([0.2, 0.5, 0.9])


def constant(roughness: float = 1.0) -> Material:
    return Material(ALBEDO.expand(4, 4, 3).contiguous(), torch.full((4, 4, 1), roughness))


def constant_light(height: int = 8) -> SampledLight:
    return SampledLight.of(RADIANCE.expand(height, 2 * height, 3).contiguous())


def surface_of(normal: torch.Tensor, view: torch.Tensor, uv: torch.Tensor) -> SurfacePoints:
    """Points at the origin, seen from the front."""
    front = torch.ones(len(normal), 1, dtype=torch.bool)
    return SurfacePoints(torch.zeros_like(normal), normal, view, uv, normal, front)


# ---------------------------------------------------------------- samples
def test_weights_are_the_balance_heuristic() -> None:
    """For a black-box check: 1 / weight is n (p_light + p_brdf) >= n p_light, and nothing counts below the horizon."""
    generator = torch.Generator().manual_seed(1)
    normal = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * torch.randn(50, 3, generator=generator), dim=-1)
    light = SampledLight.of(torch.rand(8, 16, 3, generator=generator))
    rotation = torch.rand(2, 50, 3, dtype=torch.float64, generator=generator)
    drawn = draw_samples(
        surface_of(normal, view, torch.zeros(50, 2)), torch.ones(50, dtype=torch.bool), torch.full((1, 1, 1), 0.4),
        light.sampler, rotation, points=1, count=12,
    )  # fmt: skip
    assert drawn.direction.shape == (50, 24, 3)
    torch.testing.assert_close(drawn.direction.norm(dim=-1), torch.ones(50, 24), atol=1e-5, rtol=0)
    cosine = (drawn.direction * normal[:, None]).sum(-1)
    above = cosine > 0
    assert (drawn.texel >= 0).equal(above)
    weight = torch.where(above, drawn.terms[..., 0] / cosine, 0.0)  # terms[0] is the weighted cosine
    assert (weight > 0).equal(above)
    texel = kernel_calls.direction_to_texel(drawn.direction, 8, 16)
    density = kernel_calls.density(light.sampler, kernel_calls.normal_bin(normal)[:, None], texel)
    assert (weight * 12 * density <= 1 + 1e-5).all()


# ---------------------------------------------------------------- closed forms
@pytest.mark.parametrize("side", [1, 2])
def test_lambertian_sphere_in_a_constant_light(side: int) -> None:
    """Diffuse radiance = albedo * L wherever the pixel is covered, coverage times that at the edge."""
    stage = Stage.of(sphere(3), [camera_at((2.0, -3.0, 1.0), pixels=24)], side)
    images = stage.renderer(shadows=False).render_images(
        stage.gbuffer, constant(), constant_light(), 256, torch.Generator().manual_seed(2)
    )
    coverage = stage.gbuffer.coverage()[..., None]
    expected = coverage * ALBEDO * RADIANCE
    inside = coverage[..., 0] == 1
    error = (images["diffuse"] / expected - 1)[inside]
    assert int(inside.sum()) > 150
    assert float(error.abs().max()) < 0.3
    assert float(error.mean().abs()) < 0.005  # about 200 pixels of 3 % each
    torch.testing.assert_close(images["albedo"], coverage * ALBEDO)
    torch.testing.assert_close(images["radiance"], images["diffuse"] + images["specular"])
    assert (images["radiance"][coverage[..., 0] == 0] == 0).all()
    if side == 2:
        edge = (coverage[..., 0] > 0) & ~inside
        assert float((images["diffuse"].sum(-1) / expected.sum(-1) - 1)[edge].mean().abs()) < 0.03


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
    blocked = stage.rays.occluded(
        origin.reshape(-1, 3).contiguous(), torch.from_numpy(direction).float().reshape(-1, 3)
    )
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


def test_estimator_agrees_with_brute_force(
    tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor
) -> None:
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


def test_light_sampling_share_does_not_move_the_mean(
    tiny_stage: Stage, tiny_material: Material, tiny_sun: torch.Tensor
) -> None:
    """Under a sun: half of the light samples spread evenly give the same picture as none."""
    pixels = torch.arange(0, len(tiny_stage.gbuffer.pixel), 9).repeat(30)
    renderer = tiny_stage.renderer()
    means, errors = [], []
    for seed, share in enumerate((0.0, 0.5)):
        light = SampledLight.of(tiny_sun, uniform_fraction=share)
        value = renderer.render_pixels(
            tiny_stage.gbuffer, pixels, tiny_material, light, 16, torch.Generator().manual_seed(seed)
        ).radiance.double()
        values = value.reshape(30, -1, 3).mean((1, 2))
        means.append(float(values.mean()))
        errors.append(float(values.std()) / math.sqrt(30))
    assert abs(means[0] - means[1]) < 4 * math.hypot(*errors)
    assert math.hypot(*errors) < 0.02 * means[0]


# ---------------------------------------------------------------- convergence
def spread(stage: Stage, material: Material, light: SampledLight, samples: int) -> float:
    """Root mean square of half the difference of two estimates, over the pixels, tone-mapped so that no pixel rules."""
    pixels = torch.arange(len(stage.gbuffer.pixel))
    pair = [
        stage.renderer().render_pixels(
            stage.gbuffer, pixels, material, light, samples, torch.Generator().manual_seed(s)
        )
        for s in (8, 9)
    ]
    return float(((pair[0].radiance - pair[1].radiance) ** 2).mean().sqrt())


def test_error_falls_with_samples(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """Slope of log error over log samples: -1/2 for independent samples, steeper for the lattice, never flatter."""
    samples = np.array([4, 16, 64, 256])
    light = SampledLight.of(soft_light)
    errors = [spread(tiny_stage, tiny_material, light, int(n)) for n in samples]
    slope = np.polyfit(np.log(samples), np.log(errors), 1)[0]
    assert -1.0 < slope < -0.45, f"slope {slope:.2f} of {errors}"


def test_passes_of_a_picture_share_one_lattice(
    tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor
) -> None:
    """Passes of 32 samples: independent ones would halve the error with four times as many, parts of a lattice do better."""
    light = SampledLight.of(soft_light)

    def error(samples: int, seed: int) -> float:
        pair = [
            tiny_stage.renderer().render_images(
                tiny_stage.gbuffer, tiny_material, light, samples, torch.Generator().manual_seed(s)
            )
            for s in (seed, seed + 1)
        ]
        return float(((pair[0]["radiance"] - pair[1]["radiance"]) ** 2).mean().sqrt())

    assert 0.2 < error(128, 10) / error(32, 12) < 0.45
