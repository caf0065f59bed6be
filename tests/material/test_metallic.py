"""The metallic workflow: a dielectric at 0, a conductor of the albedo's colour at 1, linear between."""

import kernel_calls
import pytest
import torch

from benchmarks.reference import shade_directions
from ia_bench.light.latlong import texel_centres
from ia_bench.material.brdf import F0, normalize
from ia_bench.material.textures import Material
from ia_bench.render.estimator import shade_samples
from ia_bench.render.gbuffer import SurfacePoints

pytestmark = pytest.mark.verify


def shaded(
    albedo: torch.Tensor, roughness: torch.Tensor, radiance: torch.Tensor, metallic: torch.Tensor | None
) -> tuple[torch.Tensor, ...]:
    """Every texel of a light as one sample of 5 points, weighted evenly: by the kernels in float32, by torch in float64."""
    drawn = torch.randn(2, 5, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    normal, view = normalize(drawn)
    view = normalize(view + 1.2 * normal)
    height, width = 6, 12
    uv = torch.rand(5, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    direction = texel_centres(height, width).double().reshape(1, -1, 3).expand(5, -1, -1)
    texel = torch.arange(height * width).expand(5, -1)
    weight = torch.where((normal[:, None] * direction).sum(-1, keepdim=True) > 0, 0.1, 0.0).double()
    if albedo.dtype == torch.float64:
        return shade_directions(normal, view, uv, direction, texel, weight, albedo, roughness, radiance, metallic)
    front = torch.ones(5, 1, dtype=torch.bool)
    surface = SurfacePoints(*(vector.float() for vector in (normal, normal, view, uv, normal)), front)
    samples = kernel_calls.samples_of(surface, direction.float(), texel, weight.float(), roughness)
    found = shade_samples(surface, samples, Material(albedo, roughness, metallic), radiance.reshape(6, 12, 3), "added", None)
    return found.diffuse, found.specular, found.albedo


@pytest.fixture(params=[torch.float32, torch.float64], ids=["kernels", "torch"])
def textures(request: pytest.FixtureRequest) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(5)
    albedo = torch.rand(3, 3, 3, generator=generator, dtype=torch.float64)
    roughness = 0.3 + 0.6 * torch.rand(3, 3, 1, generator=generator, dtype=torch.float64)
    return tuple(t.to(request.param) for t in (albedo, roughness, torch.rand(72, 3, generator=generator, dtype=torch.float64)))


def test_metallic_zero_is_the_dielectric(textures: tuple[torch.Tensor, ...]) -> None:
    for without, zero in zip(shaded(*textures, None), shaded(*textures, torch.zeros(2, 2, 1).to(textures[0])), strict=True):
        torch.testing.assert_close(zero, without)


def test_a_metal_has_no_diffuse_part_and_coloured_highlights(textures: tuple[torch.Tensor, ...]) -> None:
    """A metal of grey albedo F0 reflects as the dielectric's coat; doubling the albedo of a metal at normal adds in proportion."""
    albedo, roughness, radiance = textures
    one = torch.ones(2, 2, 1).to(albedo)
    diffuse, specular, shown = shaded(albedo, roughness, radiance, one)
    assert float(diffuse.abs().max()) == 0
    assert float(shown.std(0).max()) > 0.05
    coat = shaded(albedo, roughness, radiance, None)[1]
    torch.testing.assert_close(shaded(torch.full_like(albedo, F0), roughness, radiance, one)[1], coat)
    black = shaded(torch.zeros_like(albedo), roughness, radiance, one)[1]
    white = shaded(torch.ones_like(albedo), roughness, radiance, one)[1]
    torch.testing.assert_close(specular, black + shown * (white - black))


def test_gradients(textures: tuple[torch.Tensor, ...]) -> None:
    """Of torch's against finite differences; those of the kernels against torch's."""
    inputs = tuple(t.double().requires_grad_() for t in (*textures, torch.full((2, 2, 1), 0.4)))
    if textures[0].dtype == torch.float64:
        assert torch.autograd.gradcheck(shaded, inputs, rtol=1e-4, atol=1e-6)
        return
    single = tuple(t.detach().float().requires_grad_() for t in inputs)
    wanted = torch.autograd.grad(sum(part.square().sum() for part in shaded(*inputs)), inputs)
    found = torch.autograd.grad(sum(part.square().sum() for part in shaded(*single)), single)
    for ours, theirs in zip(found, wanted, strict=True):
        torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-4 * float(theirs.abs().max()))
