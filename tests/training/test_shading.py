"""The estimator of training images against quadrature of the same light, and the bounce against brute-force paths.

Statistical comparisons use fixed seeds and allow 4.5 standard errors of the mean: a correct estimator fails one in
150 000 of them.
"""

import math

import numpy as np
import pytest
import torch

from ia_bench.light.latlong import direction_to_texel, row_solid_angles, texel_to_direction
from ia_bench.material.brdf import normalize, specular_brdf_cosine
from ia_bench_training.lights import HEIGHT, LIGHTS, MAX_DISCS, WIDTH, Light, draw_light
from ia_bench_training.objects import Assembly, _finish
from ia_bench_training.primitives import vessel
from ia_bench_training.render import ObjectRenderer, draw_view
from ia_bench_training.shading import OFFSET, DirectLight, LightTables, cosine_directions, sample_lights
from tests.chi_square import assert_frequencies

DIRECT = DirectLight(compiled=False)
ALBEDO = 0.7


class NothingInTheWay:
    rays = 0

    def occluded(self, origins, directions):
        return torch.zeros(len(origins), dtype=torch.bool)


def uniform(seed, *shape, dtype=torch.float32):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def map_radiance(light, direction):
    return light.radiance.reshape(-1, 3)[direction_to_texel(direction, HEIGHT, WIDTH)]


def quadrature(light, integrand):
    """Integral of radiance times ``integrand`` (M, 3) -> (M, 1): 16 points a texel, 4096 a disc."""
    u, v = (x.reshape(-1) for x in torch.meshgrid(*[(torch.arange(4) + 0.5) / 4] * 2, indexing="ij"))
    texel = torch.arange(HEIGHT * WIDTH)[:, None].expand(-1, 16)
    direction = texel_to_direction(texel, u, v, HEIGHT, WIDTH)
    area = row_solid_angles(HEIGHT, WIDTH).float().repeat_interleave(WIDTH)[:, None, None] / 16
    total = (light.radiance.reshape(-1, 1, 3) * area * integrand(direction)).sum((0, 1))
    for d in range(MAX_DISCS):
        if light.cosine[d] <= 1:
            p, q = (x.reshape(-1) for x in torch.meshgrid(*[(torch.arange(64) + 0.5) / 64] * 2, indexing="ij"))
            cosine = 1 - p * (1 - light.cosine[d])
            around = torch.stack([(1 - cosine**2).sqrt() * f(2 * math.pi * q) for f in (torch.cos, torch.sin)] + [cosine], -1)
            axis = light.direction[d]
            helper = torch.eye(3)[int(axis.abs().argmin())]
            x = normalize(torch.linalg.cross(helper, axis)[None])[0]
            inside = around @ torch.stack([x, torch.linalg.cross(axis, x), axis])
            total = total + light.emission[d] * 2 * math.pi * (1 - light.cosine[d]) * integrand(inside).mean(0)
    return total


def estimate(light, normal, view, roughness, count):
    points = count
    rows = [x.expand(points, 3) for x in (torch.zeros(3), normal, view, normal)]
    cosine_rays = cosine_directions(rows[1], uniform(1, points, 4, 2))
    return DIRECT(
        NothingInTheWay(), LightTables.build([light]), torch.zeros(points, dtype=torch.long), *rows,
        torch.full((points, 1), roughness), cosine_rays, None,
        uniform(2, points, 9, 2, dtype=torch.float64), uniform(3, points, 3, 2),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_direct_light_agrees_with_quadrature(seed):
    light = draw_light(np.random.default_rng([7, seed]))
    normal = normalize(torch.randn(3, generator=torch.Generator().manual_seed(seed)))
    view = normalize(normal + 0.7 * normalize(torch.randn(3, generator=torch.Generator().manual_seed(seed + 50))))
    roughness = 0.35 + 0.1 * seed
    diffuse, specular = estimate(light, normal, view, roughness, 4096)
    expected = quadrature(light, lambda d: (d @ normal).clamp_min(0)[..., None] / math.pi)
    shine = quadrature(light, lambda d: specular_brdf_cosine(normal, view, d, torch.tensor([roughness])))
    for found, wanted in ((diffuse, expected), (specular, shine)):
        error = found.std(0) / math.sqrt(len(found))
        assert ((found.mean(0) - wanted).abs() < 4.5 * error + 2e-3 * wanted).all(), f"{found.mean(0)} against {wanted}"


def test_light_samples_follow_power():
    light = draw_light(np.random.default_rng([7, 0]))
    tables = LightTables.build([light, light])
    u = uniform(4, 1, 200_000, 2, dtype=torch.float64)
    direction = sample_lights(torch.ones(1, dtype=torch.long), u, tables)[0]
    observed = np.bincount(direction_to_texel(direction, HEIGHT, WIDTH).numpy(), minlength=HEIGHT * WIDTH).astype(float)
    area = row_solid_angles(HEIGHT, WIDTH).repeat_interleave(WIDTH)
    expected = (tables.density[: HEIGHT * WIDTH].double() * area).numpy() * len(direction)
    near_disc = np.zeros(HEIGHT * WIDTH, bool)
    for d in range(MAX_DISCS):  # texels that a disc touches hold its samples too
        if light.cosine[d] <= 1:
            middle = texel_to_direction(torch.arange(HEIGHT * WIDTH), torch.tensor(0.5), torch.tensor(0.5), HEIGHT, WIDTH)
            reach = math.acos(float(light.cosine[d])) + math.radians(3)
            near_disc |= (middle @ light.direction[d] > math.cos(reach)).numpy()
    observed = np.append(observed[~near_disc], observed[near_disc].sum())
    expected = np.append(expected[~near_disc], len(direction) - expected[~near_disc].sum())
    assert_frequencies(observed, expected)


@pytest.mark.parametrize("family", [family for family, _ in LIGHTS], ids=lambda f: f.__name__)
def test_every_family_of_lights_is_finite_and_bright(family, monkeypatch):
    monkeypatch.setattr("ia_bench_training.lights.LIGHTS", ((family, 1.0),))
    for seed in range(8):
        light = draw_light(np.random.default_rng(seed))
        assert torch.isfinite(light.radiance).all()
        assert (light.radiance > 0).all()
        assert torch.isfinite(light.emission).all()
        power = (light.radiance * row_solid_angles(HEIGHT, WIDTH).float()[:, None, None]).sum() / (12 * math.pi)
        assert 0.001 < power < 10


@pytest.fixture(scope="module")
def bowl():
    """A smooth bowl of albedo ALBEDO: what lies inside it lights and shades itself."""
    assembly = Assembly(np.random.default_rng(4))
    assembly.add(vessel(np.random.default_rng(4)), assembly.slot())
    return _finish(assembly)


def plain(local, axis):
    return torch.full((len(local), 3), ALBEDO), torch.ones(len(local), 1)


def brute_force(renderer, light, position, geometric, normal, paths, seed):
    """Diffuse radiance of points (N, 3) by uniform directions, ``paths`` each, with one bounce: (N, 3)."""
    generator = torch.Generator().manual_seed(seed)

    def directions(count):
        return normalize(torch.randn(count, 3, generator=generator))

    n, g, p = (x.repeat_interleave(paths, 0) for x in (normal, geometric, position))
    first = directions(len(p))
    first = torch.where((first * n).sum(-1, keepdim=True) < 0, -first, first)
    above = (first * g).sum(-1, keepdim=True) > 0
    face, barycentric, _ = renderer._rays.intersect(p + OFFSET * g, first)
    missed = (face < 0)[:, None]
    cosine = (first * n).sum(-1, keepdim=True)
    direct = above * missed * cosine * map_radiance(light, first)
    hit = renderer._surface(face.clamp_min(0), barycentric, p)
    second = directions(len(p))
    second = torch.where((second * hit.normal).sum(-1, keepdim=True) < 0, -second, second)
    free = ~renderer._rays.occluded(hit.position + OFFSET * hit.geometric, second)[:, None]
    free &= (second * hit.geometric).sum(-1, keepdim=True) > 0
    there = 2 * ALBEDO * free * (second * hit.normal).sum(-1, keepdim=True) * map_radiance(light, second)
    total = 2 * ALBEDO * (direct + above * ~missed * cosine * there)
    return total.reshape(-1, paths, 3).mean(1)


def test_one_bounce_agrees_with_brute_force_paths(bowl):
    """The mean of a picture within 1.5 %, its pixels within 6 % of the mean (root of the mean square, paths' noise included)."""
    size = 24
    renderer = ObjectRenderer(bowl, DIRECT)
    view = draw_view(np.random.default_rng(1), bowl, size)
    height = torch.cos((torch.arange(HEIGHT) + 0.5) * math.pi / HEIGHT)[:, None, None]
    smooth = (1 + 0.8 * height) * torch.tensor([1.0, 0.8, 0.6]).expand(HEIGHT, WIDTH, 3)
    up, absent = torch.tensor([[0.0, 0, 1]]).expand(MAX_DISCS, 3), torch.full((MAX_DISCS,), 2.0)
    light = Light(smooth, up, absent, torch.zeros(MAX_DISCS, 3))
    views = [type(view)(view.camera, light, [plain] * bowl.slots, 1.0, view.shift)]
    face, barycentric = renderer.trace(views)
    image = renderer.render(views, face, barycentric)
    found = image["image"][0, ..., :3] - image["specular"][0]
    inside = torch.nonzero((face[0] >= 0).all(-1))
    row, column = inside.unbind(1)
    centre = torch.from_numpy(view.camera.to_world[:3, 3]).float()
    expected = torch.zeros(len(inside), 3)
    for point in range(4):
        hits = renderer._surface(face[0, row, column, point], barycentric[0, row, column, point], centre.expand(len(row), 3))
        expected += brute_force(renderer, light, hits.position, hits.geometric, hits.normal, 150, point) / 4
    found = found[row, column]
    assert found.mean(0) / expected.mean(0) == pytest.approx([1, 1, 1], abs=0.015)
    assert float((found - expected).square().mean().sqrt() / expected.mean()) < 0.06
