"""Light that the object throws onto itself: in a hemisphere, where radiosity has a closed form, and against path tracing.

A point inside a spherical bowl sees the bowl's own wall with the same cosine-weighted share everywhere, which is the wall's
part of the sphere: one half for a hemisphere. Under light 1 from everywhere the irradiance after n bounces is therefore
pi/2 (1 + rho/2 + ... + (rho/2)^n) at every point of it.
"""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from shapes import bowl, camera_at, mesh_of, plate, sphere, together
from stage import Stage

from benchmarks import reference
from ia_bench.light.latlong import SampledLight, row_solid_angles
from ia_bench.material.brdf import normalize
from ia_bench.material.textures import Material, fetch
from ia_bench.render import indirect
from ia_bench.render.estimator import DirectionSamples, FromObject, shade_samples
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.indirect import Atlas, Interreflection, Operator
from ia_bench.render.renderer import PixelRadiance

pytestmark = [pytest.mark.verify, pytest.mark.usefixtures("own_cache")]
WHITE = torch.ones(16, 32, 3)


@pytest.fixture(scope="module")
def bowl_stage() -> Stage:
    return Stage(bowl(), [camera_at((0.0, 0.0, 4.0), pixels=24, field_of_view=24.0)])


def flat(albedo: float, roughness: float = 0.5) -> Material:
    return Material(torch.full((4, 4, 3), albedo), torch.full((4, 4, 1), roughness))


def render(stage: Stage, material: Material, *, samples: int = 256, exposure: float = 1.0, **settings: object) -> PixelRadiance:
    return stage.estimate(stage.every, material, SampledLight.of(exposure * WHITE), samples, **settings)


def arriving(bounced: Interreflection, values: torch.Tensor, points: SurfacePoints) -> torch.Tensor:
    """Irradiance (N, 3) where the texels of the atlas have ``values``: pi times what a white matt surface shows without light."""
    count = len(points.position)
    none = torch.full((count, 2), -1, dtype=torch.int32)
    dark = DirectionSamples(torch.zeros(count, 2, 3), none, torch.zeros(count, 2, 4), torch.zeros(count, 1))
    of_object = FromObject(values, values, bounced.atlas.row, none[:, :1].contiguous())
    return math.pi * shade_samples(points, dark, flat(1.0), torch.zeros(1, 2, 3), "added", of_object).diffuse


@pytest.mark.parametrize(("bounces", "exposure"), [(1, 1.0), (2, 1.0), (5, 1.0), (2, 1e-20), (2, 1e20)])
def test_a_hemisphere_has_its_closed_form(bowl_stage: Stage, bounces: int, exposure: float) -> None:
    """0.5 % in the mean (noise of 256 samples and of the bake's directions), 3 % RMS over pixels."""
    rho = 0.8
    rendered = render(bowl_stage, flat(rho), bounces=bounces, exposure=exposure).diffuse / exposure
    wanted = 0.5 * rho * sum((0.5 * rho) ** n for n in range(bounces + 1))
    assert float(rendered.mean()) == pytest.approx(wanted, rel=5e-3)
    assert float((rendered / wanted - 1).square().mean().sqrt()) < 0.03


def test_a_white_bowl_in_a_white_furnace_disappears(bowl_stage: Stage) -> None:
    """Albedo 1 and many bounces: 1 from every direction, so its specular lobe reflects what it would without shadows."""
    material = flat(1.0, roughness=0.4)
    rendered = render(bowl_stage, material, bounces=16)
    assert float(rendered.diffuse.mean()) == pytest.approx(1.0, rel=5e-3)
    free = render(bowl_stage, material, shadows="none").specular
    assert float((rendered.specular + rendered.mirrored).mean()) == pytest.approx(float(free.mean()), rel=0.01)
    assert float(rendered.specular.mean()) < 0.8 * float(free.mean())  # so there is something to get wrong


@pytest.mark.slow
def test_against_path_tracing(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """Indirect irradiance of what the test views of `tiny` see, as a share of all that arrives: 1 % off in RMS, 3 % in the mean.

    One direction a cell and a texel leave noise in the bake, of which that of the paths here is an eighth.
    """
    bounced = tiny_stage.renderer(bounces=2).interreflection
    points = tiny_stage.points(tiny_stage.every[::3])
    light = bounced.solve(tiny_material.albedo, soft_light)
    found = arriving(bounced, light.arriving, points)
    total = math.pi * arriving(bounced, light.leaving, points) / fetch(tiny_material.albedo, points.uv)
    expected = torch.zeros_like(found)
    generator = torch.Generator().manual_seed(1)
    paths = 1024
    for _ in range(paths):
        expected += path_traced(tiny_stage, points.position, points.geometric, tiny_material.albedo, soft_light, generator) / paths
    assert float(expected.mean() / total.mean()) > 0.01
    assert float(found.mean()) == pytest.approx(float(expected.mean()), rel=0.03)
    assert float((found - expected).square().mean().sqrt() / total.square().mean().sqrt()) < 0.015


def path_traced(
    stage: Stage, position: torch.Tensor, normal: torch.Tensor, albedo: torch.Tensor, radiance: torch.Tensor, rng: torch.Generator
) -> torch.Tensor:
    """One sample of the irradiance after one and two diffuse bounces, by cosine-distributed rays."""
    from ia_bench.light.latlong import direction_to_texel

    total, weight = torch.zeros(len(position), 3), torch.full((len(position), 3), math.pi)
    alive = torch.arange(len(position))
    for bounce in range(3):
        direction = normalize(normal + normalize(torch.randn(normal.shape, generator=rng)))
        face, barycentric, _ = stage.rays.intersect(position + stage.surface.offset * normal, direction)
        missed = face < 0
        if bounce:
            texel = direction_to_texel(direction[missed], *radiance.shape[:2])
            total.index_add_(0, alive[missed], weight[missed] * radiance.reshape(-1, 3)[texel])
        geometric, where = stage.surface.geometry(face[~missed], barycentric[~missed])
        front = (geometric * direction[~missed]).sum(-1) < 0
        weight = (weight[~missed] * fetch(albedo, stage.surface.uv(face[~missed], barycentric[~missed])))[front]
        alive, position, normal = alive[~missed][front], where[front], geometric[front]
    return total


def test_gradients_of_the_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """In float64, on made-up operators, against finite differences; the texture is looked up by torch, twice differentiable."""
    monkeypatch.setattr(indirect, "fetch", reference.fetch)
    generator = torch.Generator().manual_seed(2)
    stage = Stage(plate(1.0), [camera_at((0.5, 0.5, 3.0))])
    texels = Atlas.of(stage.mesh, 3, torch.device("cpu"))
    count = len(texels.face)
    exchange = torch.rand(count, count, generator=generator, dtype=torch.float64)
    exchange *= torch.rand(count, count, generator=generator) < 0.4
    sky = torch.rand(count, 2 * indirect.SKY_ROWS**2, generator=generator, dtype=torch.float64)
    bounced = Interreflection(texels, Operator(sky), Operator(exchange), stage.surface, stage.rays, 3)
    albedo = torch.rand(2, 2, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    radiance = torch.rand(2, 4, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda a, r: bounced.solve(a, r).leaving, (albedo, radiance))
    assert torch.autograd.gradgradcheck(lambda a, r: bounced.solve(a, r).leaving, (albedo, radiance))  # for Gauss-Newton


@pytest.mark.parametrize("shape", [(32, 64), (24, 48), (32, 48), (16, 5)])
def test_the_cells_of_the_sky_have_the_power_of_a_map_of_any_shape(shape: tuple[int, int]) -> None:
    radiance = torch.rand(*shape, 3, generator=torch.Generator().manual_seed(0))
    cells = row_solid_angles(16, 32).repeat_interleave(32) @ indirect._cells(radiance).double()
    assert cells.tolist() == pytest.approx((row_solid_angles(*shape) @ radiance.double().sum(1)).tolist(), rel=1e-6)


def test_texels_inside_the_object_do_not_darken_their_neighbours() -> None:
    """A ball half sunk into a slab: texels below the slab's face are left out of every lookup."""
    slab = plate(2.0)
    ball = sphere(3)
    u, v = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0]) / (2 * math.pi) + 0.5, 0.5 + 0.5 * ball.vertices[:, 2]
    uv = np.column_stack([0.5 + 0.5 * u, v]).astype(np.float32)
    sunk = mesh_of(ball.vertices, ball.faces, normals=ball.normals, uv=uv)
    box = trimesh.creation.box((4.0, 4.0, 2.0))
    box.apply_translation((0, 0, -1.0))
    body = mesh_of(box.vertices, box.faces, uv=np.full((len(box.vertices), 2), 2.0))
    mesh = together(body, sunk, mesh_of(slab.vertices, slab.faces, normals=slab.normals, uv=0.5 * slab.uv))
    stage = Stage(mesh, [camera_at((3.0, 0.0, 3.0))])
    texels = stage.renderer(bounces=1).interreflection.atlas
    _, position = stage.surface.geometry(texels.face, texels.barycentric)
    found = position[texels.row.reshape(-1).unique()]
    assert (position[:, 2] < -0.2).any()
    assert not (found[:, 2] < -0.2).any()


def test_the_backs_of_a_sheet_get_no_indirect_light() -> None:
    stage = Stage(plate(1.0), [camera_at((0.5, 0.5, -3.0))])
    points = stage.points(stage.every)
    assert not points.front.any()
    bounced = stage.renderer(bounces=1).interreflection
    light = bounced.solve(torch.ones(2, 2, 3), WHITE)
    assert float(light.leaving.min()) > 0
    assert float(arriving(bounced, light.leaving, points).abs().max()) == 0


def test_the_operators_are_kept_and_reused(no_cache: Path) -> None:
    stages = [Stage(bowl(), [camera_at((0.0, 0.0, 4.0), pixels=24, field_of_view=24.0)]) for _ in range(2)]
    first, again = (render(stage, flat(0.5), samples=8, bounces=2, atlas_size=32).radiance for stage in stages)
    assert torch.equal(first, again)
    assert stages[1].rays.rays < 20_000  # the bake alone takes a hundred thousand
    assert len(list(no_cache.glob("interreflection-*.safetensors"))) == 1


def test_a_layered_coat_conserves_energy() -> None:
    """A white ball in a white furnace disappears: what the coat reflects and what it passes on make 1 (1 % of noise)."""
    stage = Stage(sphere(3), [camera_at((2.0, 1.0, 1.5))])
    for roughness in (0.1, 0.5, 1.0):
        rendered = render(stage, flat(1.0, roughness), samples=1024, shadows="none", coat="layered")
        assert float((rendered.radiance / rendered.albedo).mean()) == pytest.approx(1.0, abs=0.01)
