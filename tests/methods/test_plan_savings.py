"""What every decision of the plan saves, and what it costs: the plan's choice beside the next larger one.

Work is counted (rays, points, texels), and the change of the picture is bounded in dB of sRGB, peak 1, noise of 256 samples a
pixel included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from shapes import bowl, camera_at, sphere
from small_fit import plan_of

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import pixels_in_reach
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Camera, Mesh

pytestmark = pytest.mark.slow
CPU = torch.device("cpu")
SAMPLES = 256


@dataclass(frozen=True)
class Rendered:
    """A picture (V, H, W, 3) in sRGB, and the rays and surface points it took."""

    picture: np.ndarray
    rays: int
    points: int


def render(
    mesh: Mesh, cameras: list[Camera], material: Material, radiance: torch.Tensor, *, side: int, seed: int = 0, **how: Any
) -> Rendered:
    stage = Stage(mesh, CPU)
    renderer, gbuffer = stage.renderer(**{"shadows": "none", "bounces": 0, **how}), stage.gbuffer(cameras, side)
    generator = torch.Generator().manual_seed(seed)
    images = renderer.render_images(gbuffer, material, SampledLight.of(radiance), SAMPLES, generator)
    return Rendered(linear_to_srgb(images["radiance"].numpy().clip(0, 1)), stage.rays.rays, stage.surface.points)


def decibels(a: Rendered, b: Rendered) -> float:
    """Peak signal-to-noise ratio of two pictures where either shows something."""
    shown = (a.picture + b.picture).sum(-1) > 0
    return float(-10 * np.log10(np.mean((a.picture - b.picture)[shown] ** 2) + 1e-12))


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


@pytest.mark.parametrize("smooth", [False, True])
def test_no_shadow_rays_on_a_convex_mesh_change_nothing(smooth: bool) -> None:
    """With flat normals the picture is the same to the last bit (same draws), and only primary rays are traced.

    With smooth normals a ray may start above the shading normal's horizon and below its triangle's: 45 dB.
    """
    mesh, cameras = sphere(3, smooth=smooth), [camera_at((2.0, 1.5, 1.0), pixels=48)]
    plan = plan_of(mesh, *cameras)
    assert plan.shadows == "none"
    less, more = (render(mesh, cameras, material(), soft_light(16), side=2, shadows=s) for s in (plan.shadows, "traced"))
    assert less.rays == 4 * len(pixels_in_reach(cameras[0], mesh)) < 48 * 48 * 4
    assert more.rays > 10 * less.rays
    assert decibels(less, more) > 45
    if not smooth:
        np.testing.assert_array_equal(less.picture, more.picture)


def test_no_indirect_light_where_little_bounces(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A shallow dish, which sees 0.8 % of itself: against a picture with all bounces and the errors of a fit to 33 dB, leaving
    them out costs less than 0.1 dB. A deep one, where the plan keeps them, would lose more than 3.
    """
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path))
    costs = {}
    for share in (0.008, 0.5):
        mesh, cameras = bowl(share=share), [camera_at((0.0, 0.0, 4.0), pixels=48, field_of_view=20.0)]
        plan = plan_of(mesh, *cameras)
        less, more = (render(mesh, cameras, material(), soft_light(16), side=2, shadows="traced", bounces=b) for b in (0, 6))
        errors = np.random.default_rng(0).normal(0, 10 ** (-33 / 20), more.picture.shape)
        taken = replace(more, picture=more.picture + errors)
        costs[share] = decibels(more, taken) - decibels(less, taken), plan.bounces
    assert costs[0.008][1] == 0
    assert costs[0.008][0] < 0.1
    assert costs[0.5][1] > 0
    assert costs[0.5][0] > 3
