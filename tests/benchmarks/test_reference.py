"""The reference in torch renders what the renderer renders, of everything that it can be asked for."""

import pytest
import torch
from shapes import bowl, camera_at

from benchmarks.reference import TorchRenderer
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import PixelRadiance, Renderer
from ia_bench.render.stage import Stage

CPU = torch.device("cpu")


def uniform(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def scene(own_cache: None) -> tuple[Stage, GBuffer, Renderer]:
    """The inside of a bowl, 2 x 2 points a pixel, with shadows and two bounces."""
    stage = Stage(bowl(), CPU)
    renderer = stage.renderer(bounces=2, atlas_size=32)
    return stage, stage.gbuffer([camera_at((0.3, 0.2, 4.0), pixels=24, field_of_view=30.0)], 2), renderer


def leaves() -> list[torch.Tensor]:
    roughness = 0.2 + 0.7 * uniform(8, 8, 1, seed=1)
    drawn = uniform(8, 8, 3, seed=0), roughness, uniform(4, 4, 1, seed=2), uniform(16, 32, 3, seed=3)
    return [leaf.requires_grad_() for leaf in drawn]


def render(renderer: Renderer, gbuffer: GBuffer, values: list[torch.Tensor], *, metallic: bool = True) -> PixelRadiance:
    albedo, roughness, metal, light = values
    material, rng = Material(albedo, roughness, metal if metallic else None), torch.Generator().manual_seed(4)
    pixels = torch.arange(-1, len(gbuffer.pixel))
    return renderer.render_pixels(gbuffer, pixels, material, SampledLight.of(light), 32, rng)


def assert_alike(found: torch.Tensor, wanted: torch.Tensor) -> None:
    """But for the few directions that rounding moves across a border of texels or of a shadow."""
    assert wanted.abs().max() > 0
    scale = wanted.abs().mean()
    error = ((found - wanted).abs() / (wanted.abs() + scale)).flatten()
    assert float((error > 1e-3).float().mean()) < 0.02
    assert float((found - wanted).sum().abs() / wanted.abs().sum()) < 1e-3


@pytest.mark.parametrize("metallic", [False, True])
@pytest.mark.parametrize("indirect", [False, True])
def test_pixels_and_gradients(scene: tuple[Stage, GBuffer, Renderer], metallic: bool, indirect: bool) -> None:
    _, gbuffer, renderer = scene
    if not indirect:
        renderer = Renderer(renderer.surface, renderer.rays, coat="added")
    results = []
    for one in (renderer, TorchRenderer(renderer)):
        values = leaves()
        part = render(one, gbuffer, values, metallic=metallic)
        shown = [part.diffuse, part.specular, part.albedo, *([part.mirrored] if indirect else [])]
        assert (part.mirrored is not None) == indirect
        used = values if metallic else [values[0], values[1], values[3]]
        results.append(shown + list(torch.autograd.grad(part.radiance.square().sum() + part.albedo.sum(), used)))
    for found, wanted in zip(*results, strict=True):
        assert_alike(found.detach(), wanted.detach())


def test_second_derivatives(scene: tuple[Stage, GBuffer, Renderer]) -> None:
    """Of the mean radiance along a change of the albedo, of which it is a polynomial of degree 3 (two bounces)."""
    _, gbuffer, renderer = scene
    albedo, roughness, metallic, light = leaves()

    def mean(albedo: torch.Tensor) -> torch.Tensor:
        values = [albedo, roughness.detach(), metallic.detach(), light.detach()]
        return render(TorchRenderer(renderer), gbuffer, values).radiance.double().mean()

    (slope,) = torch.autograd.grad(mean(albedo), albedo, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), albedo)
    step = 0.05
    low, middle, high = (mean(albedo.detach() + change) for change in (-step, 0.0, step))
    assert float(bend.sum()) == pytest.approx(float(high - 2 * middle + low) / step**2, rel=0.02)
