"""The control variate of diffuse light changes the noise of an estimate and nothing else, whatever its bake says."""

import math
from copy import copy
from dataclasses import replace

import pytest
import torch
from shapes import bowl, camera_at, plate
from stage import Stage
from torch import Tensor

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight, row_solid_angles, texel_centres
from ia_bench.material.textures import Material
from ia_bench.render.control import DiffuseControl
from ia_bench.render.indirect import SKY_ROWS
from ia_bench.render.renderer import Renderer

pytestmark = [pytest.mark.verify, pytest.mark.usefixtures("own_cache")]
TIMES = 48


def renderer_of(stage: Stage, *, controlled: bool, coat: str = "added") -> Renderer:
    return stage.renderer(bounces=1, atlas_size=64, control_variate=controlled, coat=coat)


def diffuse(stage: Stage, renderer: Renderer, material: Material, light: Tensor, times: int = TIMES) -> Tensor:
    """(times, P, 3) independent estimates of 8 samples a point."""
    generator, sampled = torch.Generator().manual_seed(5), SampledLight.of(light)
    return torch.stack(
        [renderer.render_pixels(stage.seen, stage.every[::3], material, sampled, 8, generator).diffuse for _ in range(times)]
    )


def off(one: Tensor, other: Tensor) -> float:
    """By how many standard errors the means over pixels and channels of two sets of estimates (times, P, 3) differ."""
    means = [each.mean((1, 2)) for each in (one, other)]
    error = math.sqrt(sum(float(mean.var()) / len(mean) for mean in means))
    return abs(float(means[0].mean() - means[1].mean())) / error


def test_a_hemisphere_keeps_its_closed_form() -> None:
    """See test_indirect: rho / 2 (1 + rho / 2) under light 1 from everywhere; 1 %, as of 48 times 8 samples of 100 pixels."""
    stage = Stage(bowl(), [camera_at((0.0, 0.0, 4.0), pixels=24, field_of_view=24.0)])
    material = Material(torch.full((4, 4, 3), 0.8), torch.full((4, 4, 1), 0.5))
    found = diffuse(stage, renderer_of(stage, controlled=True), material, torch.ones(16, 32, 3))
    assert float(found.mean()) == pytest.approx(0.5 * 0.8 * 1.4, rel=0.01)


@pytest.mark.parametrize("rows", [8, 24, 32])
def test_it_takes_noise_away_and_moves_nothing(tiny_stage: Stage, tiny_material: Material, soft_light: Tensor, rows: int) -> None:
    """Lights of fewer, of unequal and of more rows than the bake's 16. Means within 4 standard errors (1 in 16 000)."""
    light = LatLongEnvironment(soft_light).latlong(rows)
    plain, with_it = (
        diffuse(tiny_stage, renderer_of(tiny_stage, controlled=controlled), tiny_material, light) for controlled in (False, True)
    )
    assert off(plain, with_it) < 4
    error = ((plain.var(0) + with_it.var(0)) / TIMES).sqrt()
    assert float(((with_it.mean(0) - plain.mean(0)) / error)[error > 0].std()) == pytest.approx(1, abs=0.2)  # of single pixels too
    assert float(with_it.var(0).mean()) < 0.6 * float(plain.var(0).mean())


def test_a_bake_that_is_wrong_costs_noise_alone(tiny_stage: Stage, tiny_material: Material, soft_light: Tensor) -> None:
    """Half of what its texels see is forgotten. Means within 4 standard errors (1 in 16 000)."""
    whole, right = (renderer_of(tiny_stage, controlled=controlled) for controlled in (False, True))
    wrong = copy(right)
    wrong.interreflection = copy(right.interreflection)
    free = right.interreflection.sky.matrix.to_dense() > 0
    kept = torch.rand(free.shape, generator=torch.Generator().manual_seed(0)) < 0.5
    wrong.interreflection.control = DiffuseControl(free & kept, SKY_ROWS)
    plain, with_it, found = (diffuse(tiny_stage, renderer, tiny_material, soft_light) for renderer in (whole, right, wrong))
    assert off(plain, found) < 4
    assert float(found.var(0).mean()) > 1.5 * float(with_it.var(0).mean())


@pytest.mark.parametrize("leaf", ["light", "albedo"])
def test_gradients_are_those_of_the_estimate(tiny_stage: Stage, tiny_material: Material, soft_light: Tensor, leaf: str) -> None:
    """With one bounce an estimate is linear in the light and quadratic in the albedo, of which central differences are exact."""
    renderer = renderer_of(tiny_stage, controlled=True, coat="layered")
    pixels, generator = tiny_stage.every[::3], torch.Generator().manual_seed(1)
    wanted = torch.rand(len(pixels), 3, generator=generator)
    start = {"light": soft_light, "albedo": tiny_material.albedo}[leaf]

    def estimate(values: Tensor) -> Tensor:
        light = values if leaf == "light" else soft_light
        material = replace(tiny_material, albedo=values) if leaf == "albedo" else tiny_material
        sampled, drawn = SampledLight(light, SampledLight.of(soft_light).sampler), torch.Generator().manual_seed(5)
        return (wanted * renderer.render_pixels(tiny_stage.seen, pixels, material, sampled, 8, drawn).radiance).sum()

    step = 0.5 * torch.rand(start.shape, generator=generator) * start
    (gradient,) = torch.autograd.grad(estimate(values := start.clone().requires_grad_()), values)
    moved = 0.5 * (estimate(start + step) - estimate(start - step))
    assert float(moved) == pytest.approx(float((gradient * step).sum()), rel=2e-4)


def test_what_is_known_is_the_sum_over_cells() -> None:
    """In float64: of free cells that are above the horizon, cosine times solid angle times radiance; and its transpose."""
    generator = torch.Generator().manual_seed(3)
    free = torch.rand(7, 2 * SKY_ROWS**2, generator=generator) < 0.6
    control = DiffuseControl(free, SKY_ROWS)
    row = torch.randint(-1, 7, (300,), generator=generator, dtype=torch.int32)
    normal = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=1)
    sky = torch.rand(free.shape[1], 3, generator=generator).requires_grad_()
    found = control.at(sky, row, normal).irradiance()
    cosine = normal.double() @ texel_centres(SKY_ROWS, 2 * SKY_ROWS).reshape(-1, 3).T.double()
    solid_angle = row_solid_angles(SKY_ROWS, 2 * SKY_ROWS).repeat_interleave(2 * SKY_ROWS)
    reach = math.sqrt(2) * math.pi / SKY_ROWS  # no cell is larger
    bounds = []
    for least in (reach, 0.0):  # which cells are above the horizon is the control's own affair, but for these
        weight = torch.where((cosine > least) & free[row.long()] & (row >= 0)[:, None], cosine * solid_angle, 0)
        bounds.append(weight @ sky.detach().double())
    within = (found >= bounds[0] - 1e-4) & (found <= bounds[1] + 1e-4)
    assert within.all()
    assert float(found.detach().mean()) > 0.9 * float(bounds[1].mean())
    given = torch.randn(300, 3, generator=generator)
    (gradient,) = torch.autograd.grad((found * given).sum(), sky)
    assert float((gradient * sky.detach()).sum()) == pytest.approx(float((found.detach() * given).sum()), rel=1e-4)


def test_the_back_of_a_sheet_goes_without() -> None:
    """What texels see from the front says nothing of it: the same samples give the same estimate."""
    stage = Stage(plate(1.0), [camera_at((0.5, 0.5, -3.0))])
    material = Material(torch.full((4, 4, 3), 0.8), torch.full((4, 4, 1), 0.5))
    light = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0))
    plain, with_it = (diffuse(stage, renderer_of(stage, controlled=controlled), material, light, 1) for controlled in (False, True))
    assert torch.equal(plain, with_it)
