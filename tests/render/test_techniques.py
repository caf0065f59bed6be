"""The estimator's two techniques: joined they agree with each alone, and more of them bring the error down as they should.

Against brute force: test_estimator.py. Each technique alone is written out here from what light and BRDF offer publicly.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from kernel_calls import density as light_density
from kernel_calls import normal_bin, sample_texel
from means import assert_same_mean
from stage import Stage

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight, direction_to_texel, texel_to_direction
from ia_bench.material.brdf import dot, sample_visible_ggx, specular_brdf_cosine, visible_ggx_pdf
from ia_bench.material.textures import Material, fetch

pytestmark = pytest.mark.verify

PIXELS, REPEATS = 100, 64


@pytest.fixture(scope="module")
def pixels(tiny_stage: Stage) -> torch.Tensor:
    """Some entries of the G-buffer that are not seen at grazing."""
    chosen = torch.randperm(len(tiny_stage.gbuffer.pixel), generator=torch.Generator().manual_seed(0))[:PIXELS]
    points = tiny_stage.points(chosen)
    return chosen[dot(points.normal, points.view)[:, 0] > 0.05]


def with_roughness(material: Material, roughness: float | None) -> Material:
    return material if roughness is None else Material(material.albedo, torch.full((1, 1, 1), roughness))


def joined(stage: Stage, pixels: torch.Tensor, material: Material, light: SampledLight, samples: int, repeats: int) -> np.ndarray:
    """Diffuse and specular radiance by the renderer, (repeats, P, 2, 3)."""
    drawn = stage.renderer().render_pixels(
        stage.gbuffer, pixels.repeat(repeats), material, light, samples, torch.Generator().manual_seed(2)
    )
    return torch.stack([drawn.diffuse, drawn.specular], 1).reshape(repeats, len(pixels), 2, 3).double().numpy()


def alone(technique: str, stage: Stage, pixels: torch.Tensor, material: Material, light: SampledLight, samples: int) -> np.ndarray:
    """The same from one technique's independent samples: radiance V f cos / its density, (REPEATS, P, 2, 3)."""
    points = stage.points(pixels.repeat(REPEATS))
    normal, view = points.normal[:, None], points.view[:, None]
    roughness = fetch(material.roughness, points.uv)[:, None]
    u = torch.rand(len(normal), samples, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    height, width = light.radiance.shape[:2]
    cell = normal_bin(points.normal)[:, None]
    if technique == "light":
        texel = sample_texel(light.sampler, cell, u[..., 0])
        direction = texel_to_direction(texel, u[..., 1].float(), u[..., 2].float(), height, width)
        density = light_density(light.sampler, cell, texel)[..., None]
    else:
        direction = sample_visible_ggx(normal, view, roughness, u[..., :2].float())
        texel = direction_to_texel(direction, height, width)
        density = visible_ggx_pdf(normal, view, direction, roughness)
    cosine = dot(normal, direction).clamp_min(0)
    origin = (points.position + stage.surface.offset * points.geometric)[:, None].expand_as(direction)
    blocked = stage.rays.occluded(origin.reshape(-1, 3).contiguous(), direction.reshape(-1, 3).contiguous())
    counts = (cosine > 0) & ~blocked.reshape(cosine.shape)
    incoming = torch.where(counts, light.radiance.reshape(-1, 3)[texel] / density, 0.0)
    diffuse = (incoming * cosine).mean(1) * fetch(material.albedo, points.uv) / torch.pi
    specular = (incoming * specular_brdf_cosine(normal, view, direction, roughness)).mean(1)
    return torch.stack([diffuse, specular], 1).reshape(REPEATS, len(pixels), 2, 3).double().numpy()


@pytest.mark.parametrize(
    ("technique", "roughness", "parts"),
    [
        ("light", None, slice(0, 2)),
        ("light", 0.1, slice(0, 1)),  # specular: the light's samples hardly meet so narrow a lobe
        ("brdf", None, slice(0, 2)),
        ("brdf", 0.1, slice(1, 2)),  # diffuse: visible normals of so narrow a lobe hardly leave it
    ],
)
def test_both_agree_with_one_alone(
    tiny_stage: Stage,
    tiny_material: Material,
    soft_light: torch.Tensor,
    pixels: torch.Tensor,
    technique: str,
    roughness: float | None,
    parts: slice,
) -> None:
    """t-test of every pixel and part, shadows included, and of their sum to 0.4 %.

    Left out are pixels below 2 % of the mean: what a narrow lobe mirrors there is blocked, and the rest is rare events.
    """
    light = SampledLight.of(LatLongEnvironment(soft_light).latlong(16))
    material = with_roughness(tiny_material, roughness)
    both = joined(tiny_stage, pixels, material, light, 128, REPEATS)[:, :, parts].mean(-1)  # channels share their samples
    one = alone(technique, tiny_stage, pixels, material, light, 256)[:, :, parts].mean(-1)
    lit = both.mean(0) > 0.02 * both.mean()
    assert lit.mean() > 0.8
    assert_same_mean(both[:, lit], one[:, lit], resolution=4e-3)


@pytest.mark.parametrize("light_name", ["soft", "sun"])
def test_error_falls_as_the_root_of_the_samples(
    tiny_stage: Stage,
    tiny_material: Material,
    soft_light: torch.Tensor,
    tiny_sun: torch.Tensor,
    pixels: torch.Tensor,
    light_name: str,
) -> None:
    """Slope of log error over log samples from 8 to 512 independent samples: -1/2.

    The error is that against the mean of as many other estimates, so that an estimator that is biased by what it sees few
    of would flatten out. Over ten seeds the slope is -0.493 +- 0.006 (soft) and -0.490 +- 0.005 (sun; a standard deviation each).
    """
    light = SampledLight.of(soft_light if light_name == "soft" else tiny_sun)
    groups = 1024
    drawn = joined(tiny_stage, pixels, tiny_material, light, 8, 2 * groups).sum(2)
    truth = drawn[groups:].mean(0)
    counts = np.array([1, 4, 16, 64])
    errors = [
        np.sqrt((((drawn[:groups].reshape(-1, n, *truth.shape).mean(1) - truth) / (truth + truth.mean())) ** 2).mean())
        for n in counts
    ]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(slope + 0.5) < 0.04, f"slope {slope:.3f} of {errors}"
