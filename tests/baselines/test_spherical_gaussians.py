"""Spherical Gaussians against quadrature over the sphere: energy, products, integrals over the hemisphere, GGX, fits of a light."""

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.brdf import specular_brdf_cosine
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench_baselines.common.spherical_gaussians import fit
from ia_bench_baselines.common.spherical_gaussians.__main__ import main
from ia_bench_baselines.common.spherical_gaussians.lobes import (
    SphericalGaussianEnvironment,
    SphericalGaussians,
    clamped_cosine_integral,
    fibonacci_axes,
    hemisphere_integral,
    lobe_integral,
    product,
)
from ia_bench_baselines.common.spherical_gaussians.sampling import draw_directions
from ia_bench_baselines.common.spherical_gaussians.shading import Gloss, glossy, irradiance, reflected_lobe

ROWS = 256
DIRECTIONS = texel_centres(ROWS, 2 * ROWS).double().reshape(-1, 3)
SOLID_ANGLE = row_solid_angles(ROWS, 2 * ROWS).repeat_interleave(2 * ROWS)
UP = torch.tensor([[0.0, 0.0, 1.0]])


def tilted(degrees: float) -> Tensor:
    return torch.tensor([[math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))]])


def lobe(axis: Tensor, sharpness: float) -> Tensor:
    """Its values at all DIRECTIONS, float64."""
    return torch.exp(sharpness * (DIRECTIONS @ axis[0].double() - 1))


def random_lobes(count: int, seed: int, *shape: int) -> SphericalGaussians:
    generator = torch.Generator().manual_seed(seed)
    axis = torch.nn.functional.normalize(torch.randn(*shape, count, 3, generator=generator), dim=-1)
    sharpness = torch.exp(torch.rand(*shape, count, generator=generator) * math.log(100)) * 2
    return SphericalGaussians(axis, sharpness, torch.rand(*shape, count, 3, generator=generator))


@pytest.mark.parametrize("sharpness", [0.1, 3.0, 300.0])
def test_energy_is_the_integral_over_the_sphere(sharpness: float) -> None:
    expected = float(SOLID_ANGLE @ lobe(tilted(50), sharpness))
    assert float(lobe_integral(torch.tensor(sharpness))) == pytest.approx(expected, rel=1e-3)


PAIRS = [(4.0, 4.0, 180.0), (0.03, 900.0, 120.0), (50.0, 20.0, 15.0), (3e4, 2.0, 70.0)]


@pytest.mark.parametrize(("first", "second", "degrees"), PAIRS)
def test_a_product_of_two_lobes_is_a_lobe(first: float, second: float, degrees: float) -> None:
    one, other = tilted(0).double(), tilted(degrees).double()
    sharpness, amplitude = product(torch.tensor(first), torch.tensor(second), (tilted(0) @ tilted(degrees).T)[0, 0])
    axis = first * one + second * other
    axis = axis / axis.norm() if axis.norm() > 1e-3 else axis  # of a constant there is no axis
    near = torch.nn.functional.normalize(axis + 0.3 * one + 1e-3, dim=1)
    for direction in (one, other, near):
        expected = torch.exp(first * (direction @ one.T - 1) + second * (direction @ other.T - 1))
        found = amplitude * torch.exp(sharpness * ((direction @ axis.T).float() - 1))
        assert float(found) == pytest.approx(float(expected), rel=2e-2 if first > 1e4 else 1e-3, abs=1e-6)


@pytest.mark.parametrize("sharpness", [0.1, 0.5, 2.0, 10.0, 60.0, 300.0])
@pytest.mark.parametrize("degrees", [0.0, 45.0, 80.0, 95.0, 130.0, 180.0])
def test_integrals_over_the_hemisphere(sharpness: float, degrees: float) -> None:
    values, cosine = lobe(tilted(degrees), sharpness) * SOLID_ANGLE, DIRECTIONS[:, 2].clamp_min(0)
    mass, given = float(values.sum()), (torch.tensor(sharpness), torch.tensor(math.cos(math.radians(degrees))))
    assert float(hemisphere_integral(*given)) == pytest.approx(float(values @ (cosine > 0).double()), abs=0.015 * mass)
    assert float(clamped_cosine_integral(*given)) == pytest.approx(float(values @ cosine), abs=0.02 * mass)


def test_an_even_sky_gives_an_irradiance_of_pi() -> None:
    axis = fibonacci_axes(128)
    even = SphericalGaussians(axis, torch.full((128,), 10.0), torch.ones(128, 3))
    even = even._replace(amplitude=even.amplitude * 4 * math.pi / even.energy().sum(0))
    assert torch.allclose(irradiance(even, fibonacci_axes(50)), torch.tensor(math.pi), rtol=0.02)
    half = torch.full((50, 128), 0.5)
    assert torch.allclose(irradiance(even, fibonacci_axes(50), half), torch.tensor(math.pi / 2), rtol=0.02)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 70.0])
def test_gloss_in_closed_form_is_its_own_quadrature(roughness: float, degrees: float) -> None:
    lobes, view, rough = random_lobes(16, 1), tilted(degrees), torch.tensor([[roughness]])
    axis, sharpness, amplitude = reflected_lobe(UP, view, rough, Gloss())
    lit = SphericalGaussians(*(part.double() for part in lobes)).radiance(DIRECTIONS)
    weight = lobe(axis, float(sharpness)) * float(amplitude) * DIRECTIONS[:, 2].clamp_min(0) * SOLID_ANGLE
    expected = (weight[:, None] * lit).sum(0)
    assert torch.allclose(glossy(lobes, UP, view, rough)[0].double(), expected, rtol=0.045)


@pytest.mark.parametrize("gloss", [Gloss(), Gloss(0.02, 2.0)])
@pytest.mark.parametrize(("roughness", "degrees"), [(0.2, 0.0), (0.35, 30.0), (0.6, 0.0), (0.6, 45.0)])
def test_gloss_is_near_ggx_under_a_smooth_light(gloss: Gloss, roughness: float, degrees: float) -> None:
    light = SphericalGaussians(UP, torch.tensor([3.0]), torch.ones(1, 3))
    view, rough = tilted(degrees).double(), torch.tensor([[roughness]], dtype=torch.float64)
    brdf = specular_brdf_cosine(UP.double(), view, DIRECTIONS, rough)[:, 0]
    expected = float((brdf * lobe(UP, 3.0)) @ SOLID_ANGLE)
    found = float(glossy(light, UP, tilted(degrees), torch.tensor([[roughness]]), gloss)[0, 0])
    assert 0.9 < found / expected < 1.3


def test_drawn_directions_add_up_to_the_irradiance() -> None:
    """Each weight is 1 / (D density), of three techniques: their sums are the irradiance that a quadrature finds."""
    lobes = random_lobes(12, 4)
    lobes = lobes._replace(sharpness=lobes.sharpness.clone().index_fill(0, torch.tensor([0]), 3000.0))  # a sun
    normal = tilted(30).expand(1000, 3)
    points = SurfacePoints(normal, normal, tilted(0).expand(1000, 3), normal[:, :2], normal, torch.ones(1000, 1, dtype=torch.bool))
    drawn = draw_directions(lobes, points, torch.full((1000, 1), 0.3), 64, torch.Generator().manual_seed(0))
    torch.testing.assert_close(drawn.direction.norm(dim=-1), torch.ones(1000, 64))
    cosine = (drawn.direction @ tilted(30)[0]).clamp_min(0)
    found = ((cosine * drawn.weight)[..., None] * drawn.radiance).sum(1)
    value = SphericalGaussians(*(part.double() for part in lobes)).radiance(DIRECTIONS)
    true = ((DIRECTIONS @ tilted(30)[0].double()).clamp_min(0) * SOLID_ANGLE) @ value
    torch.testing.assert_close(found.mean(0).double(), true, rtol=0.01, atol=0)
    assert bool((drawn.weight[drawn.direction @ tilted(30)[0] <= 0] == 0).all())


# ---- fits of a light -------------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("no_cache")
def test_a_fit_finds_lobes_again_and_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "STEPS", 150)
    light = SphericalGaussianEnvironment(random_lobes(5, 4))
    found = fit.fit_light(light, count=24)
    lost = fit.residual(light.latlong(fit.ROWS), found)
    assert lost.mean < 0.005
    assert lost.worst < 0.02
    assert abs(lost.energy) < 0.002
    normal = fibonacci_axes(9)
    assert torch.allclose(irradiance(found, normal), irradiance(light.lobes, normal), rtol=0.06)
    monkeypatch.setattr(fit, "_fit", lambda *_: pytest.fail("it was kept"))
    assert all(torch.equal(one, other) for one, other in zip(fit.fit_light(light, count=24), found, strict=True))


def test_a_light_that_is_missing_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "none.exr")]) == 2
    assert capsys.readouterr().err == f"ia_bench: {tmp_path / 'none.exr'}: no such image\n"
