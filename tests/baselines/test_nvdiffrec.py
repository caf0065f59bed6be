"""Split-sum shading against integrals that are added up one direction after the other, and nvdiffrec as a method."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from ia_bench.light.latlong import texel_centres
from ia_bench.material.textures import splat
from ia_bench.scenes.scene import Scene
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.textured import TexturedScene
from ia_bench_baselines.nvdiffrec.fit import reconstruction
from ia_bench_baselines.nvdiffrec.method import Nvdiffrec, NvdiffrecOptions
from ia_bench_baselines.nvdiffrec.prefilter import PrefilteredLight, lobe_kernel
from ia_bench_baselines.nvdiffrec.split_sum import shade
from tests.baselines.home_ground import check_recovered, problem_of, smooth_light, smooth_material
from tests.baselines.reflecting import directions


def brute_force(light: Callable[[Tensor], Tensor], view: Tensor, roughness: float, f0: float) -> Tensor:
    """The integral (3,) of light times Cook-Torrance BRDF times cosine around n = +z, written down anew in float64."""
    incident, area = directions(512)
    half = torch.nn.functional.normalize(incident + view, dim=-1)
    cos_i, cos_o, cos_h, cos_d = incident[:, 2], view[2], half[:, 2], (half @ view).clamp(0, 1)
    alpha2 = roughness**4
    distribution = alpha2 / (math.pi * (cos_h**2 * (alpha2 - 1) + 1) ** 2)
    lambdas = [(torch.sqrt(1 + alpha2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i.clamp_min(1e-6), cos_o)]
    fresnel = f0 + (1 - f0) * (1 - cos_d) ** 5
    value = distribution * fresnel / (1 + lambdas[0] + lambdas[1]) / (4 * cos_i.clamp_min(1e-6) * cos_o)
    weight = torch.where(cos_i > 0, value * cos_i * area, torch.zeros_like(cos_i))
    return (light(incident) * weight[:, None]).sum(0)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 75.0])
def test_under_white_light_it_is_exact(roughness: float, degrees: float):
    """A dielectric's diffuse lobe sends its colour, and its specular lobe F0 A + B. The table is looked up bilinearly."""
    view = torch.tensor([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])
    colour = torch.tensor([[0.2, 0.5, 0.8]])
    value = torch.tensor([[roughness]])
    white = PrefilteredLight(torch.ones(8, 16, 3))
    found = shade(white, torch.tensor([[0.0, 0.0, 1.0]]), view[None], colour, value, torch.zeros(1, 1))
    specular = brute_force(torch.ones_like, view.double(), roughness, 0.04)
    torch.testing.assert_close((found - colour)[0].double(), specular, rtol=0.01, atol=2e-4)


@pytest.mark.parametrize("sharpness", [6.0, 40.0])
def test_one_lobe_of_light_seen_along_the_normal(sharpness: float):
    """A split sum weighs the light by D (n.l), where the BRDF has D G F: right for smooth lobes, too much light for rough ones."""
    axis = torch.nn.functional.normalize(torch.tensor([0.1, 0.05, 1.0], dtype=torch.float64), dim=0)

    def lobe(direction: Tensor) -> Tensor:
        return torch.exp(sharpness * (direction @ axis - 1))[:, None].expand(-1, 3)

    rows = 32
    light = PrefilteredLight(lobe(texel_centres(rows, 2 * rows).double().reshape(-1, 3)).float().reshape(rows, 2 * rows, 3))
    up, ratio = torch.tensor([[0.0, 0.0, 1.0]]), {}
    for roughness in (0.2, 0.3, 0.8):
        found = shade(light, up, up, torch.zeros(1, 3), torch.tensor([[roughness]]), torch.zeros(1, 1))
        ratio[roughness] = float(found[0, 0] / brute_force(lobe, up[0].double(), roughness, 0.04)[0])
    assert ratio[0.2] == pytest.approx(1, abs=0.03)
    assert ratio[0.3] == pytest.approx(1, abs=0.06)
    assert 1.1 < ratio[0.8] < 1.35


def test_filtered_maps_are_weighted_means_of_the_light():
    """At centres of texels, where nothing is interpolated, against sums over 64 times as many directions."""
    rows = 16
    generator = torch.Generator().manual_seed(0)
    light = torch.rand(rows, 2 * rows, 3, generator=generator)
    filtered, place = PrefilteredLight(light), torch.tensor([3, 100, 250, 509])
    axis = texel_centres(rows, 2 * rows).reshape(-1, 3)[place]
    incident, area = directions(8 * rows)
    fine = light.double().repeat_interleave(8, 0).repeat_interleave(8, 1).reshape(-1, 3)
    cosine = axis.double() @ incident.T
    for found, kernel in (
        (filtered.irradiance(axis), cosine.clamp_min(0)),
        (filtered.glossy(axis, torch.full((4, 1), 0.6)), lobe_kernel(0.6)(cosine)),
    ):
        weight = kernel * area
        torch.testing.assert_close(found.double(), weight @ fine / weight.sum(1, keepdim=True), rtol=2e-3, atol=0)
    torch.testing.assert_close(filtered.glossy(axis, torch.zeros(4, 1)), light.reshape(-1, 3)[place])


def test_what_no_step_can_reach_is_filled(tiny: Scene):
    """Texels seen on the object's edge alone are in no training pixel: what the gradient does not reach must not stay as it was."""
    problem = problem_of(tiny)
    pixels = TrainingPixels(problem, 2)
    scene = TexturedScene(problem, pixels, roughness=0.5, metallic=0.1, least=0.0, least_roughness=0.08)
    scene.at(pixels.points(torch.arange(len(pixels))).uv)[0].sum().backward()
    assert scene.base_colour.grad is not None
    reached = scene.base_colour.grad.amax(-1) > 0
    face, barycentric = pixels.gbuffer.face, pixels.gbuffer.barycentric
    uv = problem.stage.surface.uv(face[face >= 0].long(), barycentric[face >= 0])
    seen = splat(uv, torch.zeros(len(uv), 0), len(reached))[1] > 0
    assert (seen & ~reached).any()
    with torch.no_grad():
        scene.base_colour[reached] = 0.2
    torch.testing.assert_close(scene.recovered().albedo, torch.full_like(scene.base_colour, 0.2))


@pytest.mark.slow
def test_on_its_home_ground_it_recovers_the_material(tiny: Scene):
    """Photographs by split sums themselves: what is left is what they do not tell, and how far 2000 steps come."""
    truth = reconstruction(problem_of(tiny), smooth_material(metallic=True), smooth_light())
    options = NvdiffrecOptions(steps=2000, light_rate=0.03, smooth_material=0.03)
    check_recovered(Nvdiffrec(options), truth, tiny, albedo=30, roughness=0.01)
