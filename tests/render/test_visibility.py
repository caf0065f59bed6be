"""Shadows: traced and none, compared where they must agree and measured where they need not."""

from __future__ import annotations

import pytest
import torch
from shapes import camera_at, sphere
from stage import Stage

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.visibility import NoShadows, TracedShadows, Visibility


def picture(stage: Stage, shadows: Visibility, material: Material, radiance: torch.Tensor) -> torch.Tensor:
    """The same draws whatever the shadows."""
    pixels = torch.arange(len(stage.gbuffer.pixel))
    light = SampledLight.of(radiance)
    renderer = stage.renderer(visibility=shadows)
    return renderer.render_pixels(
        stage.gbuffer, pixels, material, light, 256, torch.Generator().manual_seed(0)
    ).radiance


@pytest.fixture
def grey() -> Material:
    return Material(torch.full((2, 2, 3), 0.5), torch.full((2, 2, 1), 0.5))


def test_no_shadows_is_exact_on_a_convex_mesh(grey: Material) -> None:
    """With flat triangles a direction above the surface never meets it again: the same numbers, not almost."""
    stage = Stage.of(sphere(2, smooth=False), [camera_at((2.0, 1.0, 1.5))])
    radiance = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    traced = picture(stage, TracedShadows(stage.rays, stage.surface.offset), grey, radiance)
    assert stage.rays.rays > 10_000
    assert torch.equal(traced, picture(stage, NoShadows(), grey, radiance))


def test_no_shadows_is_close_on_a_convex_mesh_with_smooth_normals(grey: Material) -> None:
    """Directions above the shading normal's horizon but below the triangle's are all that differs: below 1 % here."""
    stage = Stage.of(sphere(3), [camera_at((2.0, 1.0, 1.5))])
    radiance = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    traced = picture(stage, TracedShadows(stage.rays, stage.surface.offset), grey, radiance)
    none = picture(stage, NoShadows(), grey, radiance)
    assert (none >= traced - 1e-6).all()
    assert float((none - traced).mean() / traced.mean()) < 0.01
