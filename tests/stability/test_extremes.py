"""Extreme inputs against what the answer must be: the BRDF at the ends of roughness, at grazing angles and for vectors that are
none, and a unit ball through the whole renderer, with exposures, lights, sizes and meshes at their ends."""

from collections.abc import Callable
from dataclasses import dataclass

import kernel_calls
import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import F0, MIN_ROUGHNESS, dot, normalize, sample_visible_ggx, specular_brdf_cosine, tangent_frame
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import PixelRadiance, Renderer
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Camera, Mesh

pytestmark = pytest.mark.stability

COUNT = 4096
STEP = 1e-5  # of the central differences in roughness, float64
DISTANCE = 4.0  # of the camera, in radii of the ball


def deviation(found: Tensor, reference: Tensor, floor: float = 0.0) -> float:
    """Largest |found - reference| / (|reference| + ``floor``); 0 for 0 / 0, NaN where ``found`` is."""
    difference = (found.double() - reference.double()).abs()
    scale = reference.double().abs() + floor
    return float(torch.where(difference == 0, 0.0, difference / scale).max())


def all_finite(*tensors: Tensor) -> bool:
    """Whether every value is."""
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


# ----- the BRDF ---------------------------------------------------------------------------------------------------------------
Vectors = tuple[Tensor, Tensor, Tensor]


def pairs(roughness: float, cosine: float | None) -> Vectors:
    """Normals, views and incident directions (COUNT, 3) float32, the last drawn from the lobe itself."""
    generator = torch.Generator().manual_seed(0)
    normal = normalize(torch.randn(COUNT, 3, generator=generator))
    tangent, bitangent = tangent_frame(normal)
    height = torch.rand(COUNT, 1, generator=generator) * 0.95 + 0.05 if cosine is None else torch.full((COUNT, 1), cosine)
    azimuth = 2 * torch.pi * torch.rand(COUNT, 1, generator=generator)
    side = (1 - height**2).sqrt()
    view = normalize(side * azimuth.cos() * tangent + side * azimuth.sin() * bitangent + height * normal)
    drawn = torch.rand(COUNT, 2, generator=generator)
    incident = normalize(sample_visible_ggx(normal, view, torch.full((COUNT, 1), roughness), drawn))
    above = dot(normal, incident)[:, 0] > 1e-3  # nearer to the horizon the float32 input itself decides
    return normal[above], view[above], incident[above]


def by_torch(vectors: Vectors, roughness: float) -> tuple[Tensor, Tensor]:
    """Value and slope in the roughness, (N, 1) each."""
    single = torch.full((len(vectors[0]), 1), roughness, requires_grad=True)
    value = specular_brdf_cosine(*vectors, single)
    (slope,) = torch.autograd.grad(value.sum(), single)
    return value.detach(), slope


def by_kernel(vectors: Vectors, roughness: float) -> tuple[Tensor, Tensor]:
    """The same from a kernel's lobe, whose slope is that in alpha."""
    value, slope, grazing, _ = kernel_calls.lobe(*vectors, torch.full((len(vectors[0]), 1), roughness))
    fresnel = F0 * (1 - grazing) + grazing
    return value * fresnel, 2 * roughness * slope * fresnel


By = Callable[[Vectors, float], tuple[Tensor, Tensor]]


@pytest.mark.parametrize(
    ("roughness", "cosine"), [(MIN_ROUGHNESS, None), (0.1, None), (0.5, None), (1.0, None), (0.3, 1e-4), (0.3, 1e-6)]
)
@pytest.mark.parametrize("by", [by_torch, by_kernel])
def test_float32_is_as_float64_around_the_lobe_and_at_grazing_views(by: By, roughness: float, cosine: float | None) -> None:
    """Of the slope too, which is compared with central differences."""
    vectors = pairs(roughness, cosine)
    value, gradient = by(vectors, roughness)

    def exact(offset: float) -> Tensor:
        normal, view, incident = (vector.double() for vector in vectors)
        return specular_brdf_cosine(normal, view, incident, torch.full_like(normal[:, :1], roughness + offset))

    slope = (exact(STEP) - exact(-STEP)) / (2 * STEP)
    assert all_finite(value, gradient)
    assert deviation(value, exact(0.0), 1e-3 * float(value.max())) <= 2e-3
    assert deviation(gradient, slope, 1e-3 * float(slope.abs().max())) <= 5e-3


@pytest.mark.parametrize("by", [by_torch, by_kernel])
def test_a_mirror_reflects_nothing_off_the_mirror_direction(by: By) -> None:
    value, gradient = by(pairs(0.5, None), 0.0)
    assert float(value.abs().max()) == 0
    assert all_finite(gradient)


def test_light_below_the_horizon_reflects_nothing_and_vectors_that_are_none_leave_no_nan() -> None:
    normal, view, incident = pairs(0.5, None)
    below = incident - 2 * dot(normal, incident) * normal
    value, gradient = by_torch((normal, view, below), 0.5)
    assert float(value.abs().max()) == 0
    assert float(gradient.abs().max()) == 0
    normal, view, _ = pairs(0.5, 1e-6)  # opposite to it there is no half vector
    roughness = torch.full((len(normal), 1), 0.3, requires_grad=True)
    incident = (-view).requires_grad_(True)
    value = specular_brdf_cosine(normal, view, incident, roughness)
    assert all_finite(value, *torch.autograd.grad(value.sum(), (roughness, incident)))
    assert float(value.detach().abs().max()) <= 1
    vector = torch.zeros(1, 3, requires_grad=True)
    unit = normalize(vector)
    assert all_finite(*torch.autograd.grad(unit.sum(), vector))
    assert unit.tolist() == kernel_calls.normalize(torch.zeros(1, 3)).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("frame", [tangent_frame, kernel_calls.tangent_frame], ids=["torch", "kernel"])
def test_frames_at_both_poles_and_1e_7_beside_are_orthonormal(frame: Callable[[Tensor], tuple[Tensor, Tensor]]) -> None:
    near = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1e-7, 0.0, -1.0), (0.0, -1e-7, -1.0), (1e-7, 1e-7, 1.0), (1.0, 0.0, 0.0)]
    normal = normalize(torch.tensor(near))
    axes = torch.stack([*frame(normal), normal], 1)
    assert float((axes @ axes.transpose(1, 2) - torch.eye(3)).abs().max()) <= 1e-6


# ----- a ball through the whole renderer --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setup:
    """What is rendered; the defaults are nothing special. ``copies``: how often the mesh lies in the same place."""

    exposure: float = 1.0
    light: str = "sky"
    albedo: float = 0.5
    scale: float = 1.0
    degenerate: int = 0
    copies: int = 1
    samples: int = 64
    pixels: int = 24
    seed: int = 0

    def mesh(self) -> Mesh:
        ball = trimesh.creation.icosphere(subdivisions=3)
        faces = np.concatenate([ball.faces] * self.copies + [np.zeros((self.degenerate, 3), int)])
        vertices = np.asarray(ball.vertices, np.float32)
        uv = np.full((len(vertices), 2), 0.5, np.float32)
        return Mesh(self.scale * vertices, faces.astype(np.int32), vertices, uv)

    def radiance(self) -> Tensor:
        radiance = torch.ones(32, 64, 3)
        if self.light == "sky":
            radiance[:16] *= torch.tensor([2.0, 3.0, 4.0])
        else:
            radiance[:] = 0.01
            radiance[(10, 20) if self.light == "sun" else (0, 0)] = 1e6
        return self.exposure * radiance

    def material(self) -> Material:
        return Material(torch.full((4, 4, 3), self.albedo), torch.full((4, 4, 1), 0.4))

    def scene(self, toward: float = -1.0) -> tuple[Renderer, GBuffer]:
        to_world = np.eye(4)
        to_world[2, 3] = -toward * DISTANCE * self.scale
        focal = 0.5 * self.pixels * DISTANCE / 1.2  # the ball fills five sixths of the image
        centre = 0.5 * self.pixels
        camera = Camera(to_world, (focal, focal), (centre, centre), self.pixels, self.pixels)
        stage = Stage(self.mesh(), torch.device("cpu"))
        return stage.renderer(shadows="traced", coat="added"), stage.gbuffer([camera], 2)

    def render(self, material: Material | None = None, radiance: Tensor | None = None) -> PixelRadiance:
        renderer, gbuffer = self.scene()
        light = SampledLight.of(self.radiance() if radiance is None else radiance, uniform_fraction=0.2)
        pixels, generator = torch.arange(len(gbuffer.pixel)), torch.Generator().manual_seed(self.seed)
        return renderer.render_pixels(gbuffer, pixels, material or self.material(), light, self.samples, generator)

    def mean(self) -> Tensor:
        rendered = self.render().radiance
        assert all_finite(rendered)
        return rendered.mean(0)


def with_gradient(setup: Setup) -> tuple[PixelRadiance, Tensor]:
    """The render, and the gradient of its mean in the albedo."""
    material = setup.material()
    material.albedo.requires_grad_(True)
    rendered = setup.render(material)
    (gradient,) = torch.autograd.grad(rendered.radiance.mean(), material.albedo)
    return rendered, gradient


@pytest.mark.parametrize("factor", [1e-20, 1e-3, 1e3, 1e6, 1e20])
def test_an_exposure_is_a_factor_of_radiance_and_gradient(factor: float) -> None:
    (plain, slope), (exposed, steep) = with_gradient(Setup()), with_gradient(Setup(exposure=factor))
    wanted = plain.radiance.detach().double() * factor
    assert all_finite(exposed.radiance, steep)
    assert deviation(exposed.radiance.detach(), wanted, 1e-3 * float(wanted.max())) <= 1e-4
    assert deviation(steep, slope.double() * factor) <= 1e-4


def test_a_black_light_shows_nothing_and_has_no_gradient_in_its_logarithm() -> None:
    log_light = torch.full((32, 64, 3), -torch.inf).requires_grad_(True)
    rendered = Setup().render(radiance=torch.exp(log_light))
    (gradient,) = torch.autograd.grad(rendered.radiance.mean(), log_light)
    assert float(rendered.radiance.detach().abs().max()) == 0
    assert float(gradient.abs().max()) == 0


@pytest.mark.parametrize("light", ["sun", "pole"])
def test_diffuse_radiance_is_linear_in_the_albedo_where_all_light_is_in_one_texel_of_1e6(light: str) -> None:
    setup = Setup(light=light)
    material = setup.material()
    material.albedo.requires_grad_(True)
    rendered = setup.render(material)
    (gradient,) = torch.autograd.grad(rendered.diffuse.sum(), material.albedo)
    twice = setup.render(Material(2 * material.albedo.detach(), material.roughness))
    diffuse = rendered.diffuse.detach()
    assert all_finite(rendered.radiance, gradient)
    assert deviation(twice.diffuse, 2 * diffuse, 1e-6 * float(diffuse.max())) <= 1e-4
    assert deviation(gradient.sum((0, 1)), diffuse.double().sum(0) / setup.albedo) <= 1e-4


@pytest.mark.parametrize("change", [{"scale": 1e-4}, {"scale": 1e4}, {"copies": 2}], ids=str)
def test_size_and_triangles_that_lie_twice_in_the_same_place_leave_the_mean_as_it_is(change: dict[str, float]) -> None:
    assert deviation(Setup(**change).mean(), Setup().mean()) <= 2e-3


def test_triangles_without_area_leave_every_pixel_as_it_is() -> None:
    assert deviation(Setup(degenerate=100).render().radiance, Setup().render().radiance, 1e-6) <= 1e-6


def test_an_image_of_one_pixel_is_rendered_and_a_camera_that_sees_nothing_shows_nothing() -> None:
    assert float(Setup(pixels=1).mean().abs().max()) <= 1e6
    setup = Setup()
    renderer, gbuffer = setup.scene(toward=1.0)
    generator = torch.Generator().manual_seed(0)
    images = renderer.render_images(gbuffer, setup.material(), SampledLight.of(setup.radiance()), 8, generator)
    assert float(images["radiance"].abs().max()) == 0


def test_one_sample_a_pixel_has_the_mean_of_many() -> None:
    """Of 64 renders, to 2 % of noise; one sample is two: of the light and of the BRDF."""
    few = torch.stack([Setup(samples=1, seed=seed).mean() for seed in range(64)]).mean(0)
    assert deviation(few, Setup(samples=128, seed=1000).mean()) <= 0.02
