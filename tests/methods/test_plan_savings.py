"""What every decision of the plan saves, and what it costs: the plan's choice beside the next larger one.

Rays are counted, and the change of the picture is bounded in dB of sRGB, peak 1, noise of 256 samples a pixel included.
"""

from typing import Any

import numpy as np
import pytest
import torch
from shapes import bowl, camera_at, plate, sphere
from small_fit import plan_of

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.plan import LIGHT_HEIGHTS, TEXTURE_SIZES
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Camera, Mesh

pytestmark = pytest.mark.slow
CPU = torch.device("cpu")
SAMPLES = 256


def render(
    mesh: Mesh, cameras: list[Camera], material: Material, radiance: torch.Tensor, *, side: int, seed: int = 0, **how: Any
) -> tuple[np.ndarray, int]:
    """A picture (V, H, W, 3) in sRGB, and the rays it took."""
    stage = Stage(mesh, CPU)
    renderer, gbuffer = stage.renderer(**{"shadows": "none", "bounces": 0, **how}), stage.gbuffer(cameras, side)
    generator = torch.Generator().manual_seed(seed)
    images = renderer.render_images(gbuffer, material, SampledLight.of(radiance), SAMPLES, generator)
    return linear_to_srgb(images["radiance"].numpy().clip(0, 1)), stage.rays.rays


def decibels(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two pictures where either shows something."""
    return float(-10 * np.log10(np.mean((a - b)[(a + b).sum(-1) > 0] ** 2) + 1e-12))


def soft_light(height: int) -> torch.Tensor:
    """A sky with one bright half, blurred over several texels."""
    azimuth = (torch.arange(2 * height) + 0.5) / height * np.pi
    zenith = (torch.arange(height) + 0.5) / height * np.pi
    shape = 1 + 0.8 * torch.cos(azimuth)[None] * torch.sin(zenith)[:, None]
    return (shape[..., None] * torch.tensor([0.5, 0.6, 0.7])).float()


def material(size: int = 64) -> Material:
    """Albedo of soft stripes and one roughness."""
    stripes = 0.5 + 0.3 * torch.sin(torch.arange(size) / size * 2 * np.pi * 3)
    return Material(stripes[None, :, None].expand(size, size, 3).contiguous(), torch.full((size, size, 1), 0.4))


@pytest.mark.usefixtures("no_cache")
def test_no_indirect_light_where_little_bounces() -> None:
    """A shallow dish, which sees 0.8 % of itself: against a picture with all bounces and the errors of a fit to 33 dB, leaving
    them out costs less than 0.1 dB. A deep one, where the plan keeps them, would lose more than 3.
    """
    costs = {}
    for share in (0.008, 0.5):
        mesh, cameras = bowl(share=share), [camera_at((0.0, 0.0, 4.0), pixels=48, field_of_view=20.0)]
        plan = plan_of(mesh, *cameras)
        less, more = (render(mesh, cameras, material(), soft_light(16), side=2, shadows="traced", bounces=b)[0] for b in (0, 6))
        taken = more + np.random.default_rng(0).normal(0, 10 ** (-33 / 20), more.shape)
        costs[share] = decibels(more, taken) - decibels(less, taken), plan.bounces
    assert costs[0.008][1] == 0
    assert costs[0.008][0] < 0.1
    assert costs[0.5][1] > 0
    assert costs[0.5][0] > 3


def test_the_points_chosen_are_enough_and_fewer_are_not() -> None:
    """A ball 35 pixels wide beside 8 x 8 points: at least 26 dB and at least 5 dB better than a point a pixel."""
    mesh, cameras = sphere(3), [camera_at((5.0, 0.5, 0.5), pixels=64)]
    plan = plan_of(mesh, *cameras)
    assert plan.subsamples in (2, 3)
    sides = (1, plan.subsamples, plan.subsamples + 1)
    many, _ = render(mesh, cameras, material(), soft_light(16), side=8, seed=1)
    found = {s: render(mesh, cameras, material(), soft_light(16), side=s) for s in sides}
    quality = {side: decibels(many, picture) for side, (picture, _) in found.items()}
    assert found[plan.subsamples][1] < 0.6 * found[plan.subsamples + 1][1]
    assert quality[plan.subsamples] > quality[1] + 5
    assert quality[plan.subsamples] > 26


def test_a_texture_above_the_pixels_is_not_seen() -> None:
    """A texture twice as fine, of noise that only it resolves, box-filtered to the plan's size: a quarter of the texels."""
    mesh, cameras = plate(2.0), [camera_at((0.0, 0.0, 5.0), pixels=48)]
    plan = plan_of(mesh, *cameras)
    assert plan.texture < TEXTURE_SIZES[-1]
    larger = 2 * plan.texture
    rng = torch.Generator().manual_seed(0)
    base = torch.nn.functional.interpolate(torch.rand(1, 3, 12, 12, generator=rng), larger, mode="bilinear")
    noise = 0.04 * torch.randn(1, 3, larger, larger, generator=rng)
    fine = (0.2 + 0.6 * base + noise).clamp(0, 1)
    coarse = torch.nn.functional.avg_pool2d(fine, 2)
    rough = torch.full((4, 4, 1), 0.5)
    less, more = (
        render(mesh, cameras, Material(t[0].permute(1, 2, 0).contiguous(), rough), soft_light(16), side=2)[0]
        for t in (coarse, fine)
    )
    assert decibels(less, more) > 35


def test_a_light_above_the_mirror_footprint_is_not_seen() -> None:
    """A smooth light at the plan's rows and at the next larger size, on a ball: a quarter of the texels."""
    mesh, cameras = sphere(3), [camera_at((2.5, 1.5, 1.0), pixels=16)]
    plan = plan_of(mesh, *cameras)
    assert plan.light_height < LIGHT_HEIGHTS[-1]
    larger = soft_light(2 * plan.light_height)
    coarse = LatLongEnvironment(larger).latlong(plan.light_height)
    less, more = (render(mesh, cameras, material(), light, side=2)[0] for light in (coarse, larger))
    assert decibels(less, more) > 35
