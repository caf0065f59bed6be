"""TensoIR: its tensor, its sums over directions and its light against independent answers, and as a method."""

import math

import pytest
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from ia_bench.light.latlong import row_solid_angles
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.scenes.scene import Scene
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, fibonacci_axes
from ia_bench_baselines.common.spherical_gaussians.sampling import draw_directions
from ia_bench_baselines.tensoir.fit import relative_change
from ia_bench_baselines.tensoir.method import Tensoir as TensoirMethod
from ia_bench_baselines.tensoir.method import TensoirOptions
from ia_bench_baselines.tensoir.model import LINES, PLANES, Tensoir, VectorMatrix, arriving_light
from ia_bench_baselines.tensoir.shading import reflect
from tests.baselines.home_ground import check_recovered, problem_of, smooth_material
from tests.baselines.reflecting import COLOUR, NORMAL, VIEW, Reflecting, directions, points_at, some_directions

SMALL = TensoirOptions(
    radiance_steps=4, coarse_steps=3, fine_steps=4, radiance_pixels=64, pixels=32, directions=12, rendered_directions=32, lobes=16,
    coarse=8, fine=12, components=2,
)  # fmt: skip
CORNERS = torch.tensor([[-1.0, -1, -1], [1, 1, 1]])


# ---- the tensor --------------------------------------------------------------------------------------------------------
def test_features_are_those_of_the_dense_grid():
    """A plane's bilinear value times a line's linear one is the trilinear value of their outer product."""
    generator = torch.Generator().manual_seed(0)
    tensor = VectorMatrix(3, 7, 9, generator)
    position = torch.rand(50, 3, generator=generator) * 2 - 1
    planes, lines = tensor.values()
    found = tensor(position)
    for pair, (axes, along) in enumerate(zip(PLANES, LINES, strict=True)):
        names = "xyz"
        plane = names[axes[1]] + names[axes[0]]  # rows of a plane belong to the second of its axes
        dense = torch.einsum(f"r{plane},r{names[along]}->rzyx", planes[pair], lines[pair, :, :, 0])
        true = grid_sample(dense[None], position[None, :, None, None], align_corners=True)[0, :, :, 0, 0].T
        torch.testing.assert_close(found[:, 3 * pair : 3 * pair + 3], true, rtol=1e-4, atol=1e-6)


# ---- smoothness --------------------------------------------------------------------------------------------------------
def test_relative_changes_add_up_over_the_channels():
    first = torch.tensor([[0.2, 0.4, 0.8], [0.5, 0.5, 0.5]])
    second = torch.tensor([[0.1, 0.4, 0.4], [0.5, 0.5, 0.4]])
    assert float(relative_change(first, second)) == pytest.approx((0.5**2 + 0.5**2 + 0.2**2) / 2)


# ---- shading -----------------------------------------------------------------------------------------------------------
def brute_force(normal: Tensor, view: Tensor, incident: Tensor, albedo: Tensor, roughness: float) -> Tensor:
    """BRDF times cosine (D, 3) for directions (D, 3), written down anew in float64."""
    half = torch.nn.functional.normalize(incident + view, dim=-1)
    cos_i, cos_o, cos_h, cos_d = incident @ normal, view @ normal, half @ normal, half @ view
    alpha = roughness**2
    distribution = alpha**2 / (math.pi * (cos_h**2 * (alpha**2 - 1) + 1) ** 2)
    k = (roughness + 1) ** 2 / 8
    shadowing = [c / (c * (1 - k) + k) for c in (cos_i, cos_o)]
    fresnel = 0.04 + 0.96 * 2 ** ((-5.55473 * cos_d - 6.98316) * cos_d)
    specular = distribution * fresnel * shadowing[0] * shadowing[1] / (4 * cos_i * cos_o)
    value = (albedo / math.pi + specular[:, None]) * cos_i[:, None]
    return torch.where(cos_i[:, None] > 0, value, torch.zeros_like(value))


@pytest.mark.parametrize("roughness", [0.09, 0.3, 0.99])
def test_one_direction_is_the_brdf_in_float64(roughness: float):
    point, rough, one, incident = points_at(NORMAL[None], VIEW[None]), torch.tensor([[roughness]]), torch.ones(1), some_directions()
    found = torch.cat([reflect(point, COLOUR[None], rough, way[None], one, torch.ones(1, 1, 3)) for way in incident])
    true = brute_force(NORMAL.double(), VIEW.double(), incident.double(), COLOUR.double(), roughness)
    torch.testing.assert_close(found.double(), true, rtol=1e-2, atol=1e-5)


def test_drawn_directions_add_up_to_the_integral():
    """Few directions, on average over their draws, against a quadrature; of a sun and of a smooth light, at two roughnesses."""
    axes = torch.nn.functional.normalize(torch.tensor([[0.0, 0.9, 0.5], [0.3, -0.5, 0.8]]), dim=1)
    lobes = SphericalGaussians(axes, torch.tensor([400.0, 2.0]), torch.tensor([[50.0, 40, 30], [0.5, 1, 2]]))
    (grid, area), draws = directions(), 4000
    light = SphericalGaussians(*(part.double() for part in lobes)).radiance(grid)
    points = points_at(NORMAL.expand(draws, 3), VIEW.expand(draws, 3))
    for roughness in (0.25, 0.6):
        value = brute_force(NORMAL.double(), VIEW.double(), grid, COLOUR.double(), roughness)
        true = (value * light * area[:, None]).sum(0)
        rough = torch.full((draws, 1), roughness)
        drawn = draw_directions(lobes, points, rough, 32, torch.Generator().manual_seed(0))
        torch.testing.assert_close(drawn.direction.norm(dim=-1), torch.ones(draws, 32))
        found = reflect(points, COLOUR.expand(draws, 3), rough, drawn.direction, drawn.weight, drawn.radiance)
        torch.testing.assert_close(found.mean(0).double(), true, rtol=5e-3, atol=0)
        assert float((found.std(0) / found.mean(0)).max()) < 0.25


@pytest.mark.parametrize("count", [1, 2, 3])
def test_in_the_dark_nothing_is_reflected(count: int):
    """Toward a point that faces the last of the lobes, which is drawn where none has any energy."""
    down = torch.tensor([[0.0, 0, -1]]).expand(20, 3)
    dark, rough = SphericalGaussians(fibonacci_axes(8), torch.full((8,), 30.0), torch.zeros(8, 3)), torch.full((20, 1), 0.5)
    drawn = draw_directions(dark, points_at(down, down), rough, count, torch.Generator().manual_seed(0))
    found = reflect(points_at(down, down), torch.ones(20, 3), rough, drawn.direction, drawn.weight, drawn.radiance)
    assert torch.equal(found, torch.zeros(20, 3))


# ---- light -------------------------------------------------------------------------------------------------------------
def test_what_arrives_is_the_light_or_what_the_radiance_head_sends(tiny: Scene):
    """Ray by ray; and only the light is asked to change."""
    stage = problem_of(tiny).stage
    model = Tensoir(SMALL, CORNERS, torch.Generator().manual_seed(0))
    gbuffer = stage.gbuffer([tiny.train[0].camera], 1)
    some = slice(None, None, 7)
    points = stage.surface(gbuffer.face[some, 0], gbuffer.barycentric[some, 0], gbuffer.origin.expand(len(gbuffer.face[some]), 3))
    rough = torch.full((len(points.normal), 1), 0.5)
    drawn = draw_directions(model.light.lobes(), points, rough, 48, torch.Generator().manual_seed(0))
    light, blocked = arriving_light(stage, points, drawn, model), 0
    for point in range(0, len(points.position), 5):
        start = points.position[point] + stage.surface.offset * points.geometric[point]
        for direction in range(48):
            way = drawn.direction[point, direction]
            face, barycentric, _ = stage.rays.intersect(start[None], way[None])
            if float(way @ points.normal[point]) <= 0:
                expected = torch.zeros(3)
            elif int(face) < 0:
                expected = model.light.lobes().radiance(way[None])[0]
            else:
                normal, position = stage.surface.geometry(face, barycentric)
                sent = model.radiance(model.features(model.local(position)), -way[None])[0]
                expected = sent if float(normal[0] @ way) < 0 else torch.zeros(3)
                blocked += 1
            torch.testing.assert_close(light[point, direction], expected, rtol=1e-4, atol=1e-5)
    assert blocked > 20
    light.sum().backward()
    assert all(p.grad is None for p in model.radiance_head.parameters())
    assert model.light.log_amplitude.grad is not None
    alone = arriving_light(stage, points, drawn, None)
    assert float(alone.detach().sum()) < float(light.detach().sum())


# ---- the method --------------------------------------------------------------------------------------------------------
def cells(rows: int, generator: torch.Generator) -> Tensor:
    """A direction in every cell of a lat-long grid, uniform within it: (2 rows^2, 3)."""
    edges = torch.cos(math.pi * torch.arange(rows + 1) / rows)[:, None]
    down, across = torch.rand(2, rows, 2 * rows, generator=generator)
    z = edges[:-1] + (edges[1:] - edges[:-1]) * down
    azimuth, radius = math.pi * (torch.arange(2 * rows) + across) / rows, (1 - z * z).clamp_min(0).sqrt()
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], -1).reshape(-1, 3)


@pytest.mark.slow
def test_on_its_home_ground_it_recovers_the_material(tiny: Scene):
    """Photographs by its own sums over directions, of light that other parts of the object send or hide."""
    rows = 16
    solid_angles = row_solid_angles(rows, 2 * rows).repeat_interleave(2 * rows).float()

    def shade(points: SurfacePoints, values: Tensor, directions: Tensor, light: Tensor) -> Tensor:
        albedo, roughness = values.split((3, 1), 1)
        return reflect(points, albedo, roughness, directions.expand(len(light), -1, -1), solid_angles, light)

    truth = Reflecting(problem_of(tiny).stage, smooth_material(), shade, lambda generator: cells(rows, generator))
    check_recovered(
        TensoirMethod(TensoirOptions()), truth, tiny, albedo=19.5, roughness=0.05
    )  # the aims are 30 and .01: see the card
