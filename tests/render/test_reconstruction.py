"""The usual reconstruction, textures and a lat-long light, against the renderer that it stands for."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from shapes import bowl, camera_at, sphere

from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.light.latlong import SampledLight, texel_centres
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Quality, Reconstruction, TexturedReconstruction
from ia_bench.render.renderer import texture_images
from ia_bench.render.settings import REFERENCE, REFERENCE_BOUNCES
from ia_bench.render.stage import Stage

pytestmark = pytest.mark.usefixtures("own_cache")

CPU = torch.device("cpu")
ATLAS = 32  # texels along a side, as own_cache has it
CAMERAS = [camera_at((2.0, 1.0, 1.5), pixels=9), camera_at((-2.0, 1.0, 0.5), pixels=9)]
USUAL = {"albedo_scale": None, "quality": Quality(2, 16, 3)}


@pytest.fixture
def stage() -> Stage:
    ball = sphere(2)
    return Stage(replace(ball, uv=(0.5 + 0.5 * ball.vertices[:, :2]).astype(np.float32)), CPU)


def bowl_stage() -> Stage:
    """A bowl, which sees itself."""
    return Stage(bowl(8), CPU)


@pytest.fixture
def material() -> Material:
    draws = torch.Generator().manual_seed(0)
    return Material(torch.rand(8, 8, 3, generator=draws), torch.rand(8, 8, 1, generator=draws).clamp_min(0.3))


@pytest.fixture
def light() -> torch.Tensor:
    return torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))


class Sky:
    """Brighter toward +z."""

    def radiance(self, directions: torch.Tensor) -> torch.Tensor:
        return (1 + directions[:, 2:]).expand(-1, 3)

    def latlong(self, height: int) -> torch.Tensor:
        return self.radiance(texel_centres(height, 2 * height).reshape(-1, 3)).reshape(height, 2 * height, 3)


def test_maps_are_the_textures_as_the_cameras_see_them(stage: Stage, material: Material) -> None:
    found = TexturedReconstruction(stage, material, None)
    assert isinstance(found, Reconstruction)
    maps = found.maps(CAMERAS, ("albedo", "roughness", "metallic"), points=3)
    assert sorted(maps) == ["albedo", "roughness"]  # a dielectric has no metallic map
    gbuffer = stage.gbuffer(CAMERAS, 3)
    expected = texture_images(stage.surface, gbuffer, material.albedo).numpy()
    np.testing.assert_allclose(np.stack(maps["albedo"].images), expected, rtol=0, atol=1e-6)  # by another look-up
    np.testing.assert_array_equal(np.stack(maps["albedo"].coverage), gbuffer.coverage().numpy())
    assert maps["roughness"].images[0].shape == (9, 9)


def test_it_renders_as_the_reference_renderer_does(stage: Stage, material: Material, light: torch.Tensor) -> None:
    found = TexturedReconstruction(stage, material, light)
    assert found.renderer == REFERENCE
    renderer = stage.renderer(shadows="traced", bounces=REFERENCE_BOUNCES, coat="layered", atlas_size=ATLAS)
    generator = torch.Generator().manual_seed(3)
    expected = renderer.render_images(stage.gbuffer(CAMERAS, 2), material, SampledLight.of(light), 16, generator)["radiance"]
    rendered = found.render(CAMERAS, light=None, **USUAL)
    np.testing.assert_array_equal(np.stack(rendered.images), expected.numpy())
    given = found.render(CAMERAS, light=LatLongEnvironment(light), **USUAL)
    np.testing.assert_array_equal(given.images, rendered.images)


def test_what_is_smoother_than_floats_resolve_is_drawn_as_the_narrowest_lobe_and_kept_as_it_is(stage: Stage) -> None:
    """A mirror's directions have no density; drawn as such, a white light would make its diffuse part twice as bright."""
    drawn = []
    for roughness in (0.0, 1e-8, MIN_ROUGHNESS):
        grey = Material(torch.full((8, 8, 3), 0.5), torch.full((8, 8, 1), roughness))
        found = TexturedReconstruction(stage, grey, torch.ones(8, 16, 3))
        drawn.append(np.stack(found.render(CAMERAS, light=None, **USUAL).images))
        assert found.assets().roughness.max() == np.float32(roughness)
        assert found.counts() == {"texels": 64, "roughness_raised": 64 if roughness < MIN_ROUGHNESS else 0}
    np.testing.assert_array_equal(drawn[0], drawn[2])
    np.testing.assert_array_equal(drawn[1], drawn[2])
    assert drawn[0].max() < 1.1


def test_lights_of_the_same_views_share_what_the_brdf_meets(material: Material, light: torch.Tensor) -> None:
    """To the last bit what a reconstruction renders that has rendered nothing before, with fewer rays; no other pictures do."""
    bowl = bowl_stage()
    other = light.flip(0)

    def fresh(light: torch.Tensor, **settings: object) -> np.ndarray:
        alone = TexturedReconstruction(bowl, material, light).render(CAMERAS, light=None, **{**USUAL, **settings})
        return np.stack(alone.images)

    found, rays = TexturedReconstruction(bowl, material, light), bowl.apart.rays
    before = rays.rays
    np.testing.assert_array_equal(found.render(CAMERAS, light=None, **USUAL).images, fresh(light))
    first = (rays.rays - before) / 2
    before = rays.rays
    relit = found.render(CAMERAS, light=LatLongEnvironment(other), **USUAL)
    second = rays.rays - before
    np.testing.assert_array_equal(relit.images, fresh(other))
    assert 0 < second < 0.6 * first
    scale = torch.tensor([0.5, 0.7, 0.9])
    scaled = found.render(CAMERAS, light=None, **{**USUAL, "albedo_scale": scale})
    np.testing.assert_array_equal(scaled.images, fresh(light, albedo_scale=scale))
    for changed in ({"quality": Quality(2, 16, 4)}, {"quality": Quality(2, 32, 3)}, {"quality": Quality(1, 16, 3)}):
        again = found.render(CAMERAS, light=None, **{**USUAL, **changed})
        np.testing.assert_array_equal(again.images, fresh(light, **changed))
    turned = found.render(CAMERAS[::-1], light=None, **USUAL)
    whole = TexturedReconstruction(bowl, material, light).render(CAMERAS[::-1], light=None, **USUAL)
    np.testing.assert_array_equal(turned.images, whole.images)
    material.roughness.mul_(0.5)  # in place: the directions are others
    np.testing.assert_array_equal(found.render(CAMERAS, light=None, **USUAL).images, fresh(light))


def test_without_a_light_of_its_own_it_renders_under_others_only(stage: Stage, material: Material) -> None:
    found = TexturedReconstruction(stage, material, None)
    assert found.environment is None
    assert found.render(CAMERAS, light=None, **USUAL) is None
    sky = Sky()
    assert isinstance(sky, Environment)
    rendered = found.render(CAMERAS, light=sky, **USUAL)
    by_map = found.render(CAMERAS, light=LatLongEnvironment(sky.latlong(128)), **USUAL)
    np.testing.assert_array_equal(rendered.images, by_map.images)


def test_assets_hold_everything(stage: Stage, material: Material, light: torch.Tensor) -> None:
    metal = replace(material, metallic=torch.full((4, 4, 1), 0.25))
    found = TexturedReconstruction(stage, metal, light)
    again = TexturedReconstruction.of(found.assets(), stage)
    rendered = (one.render(CAMERAS, light=None, **USUAL).images for one in (again, found))
    np.testing.assert_array_equal(next(rendered), next(rendered))
    for name in ("albedo", "roughness", "metallic"):
        assert torch.equal(getattr(again.material, name), getattr(metal, name))
    bare = TexturedReconstruction(stage, material, None).assets()
    assert (bare.metallic, bare.light) == (None, None)
