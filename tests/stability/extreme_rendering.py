"""A unit ball through the whole renderer: exposures, lights, materials, sizes and meshes at their ends."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from stability.case import Case, Measured, all_finite, deviation
from torch import Tensor

from benchmarks.reference import passed_by_coat
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS, dot
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.indirect import bake_interreflection
from ia_bench.render.renderer import PixelRadiance, Renderer, TracedShadows
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Camera, Mesh

GROUP = "rendering"
CPU = torch.device("cpu")
PIXELS = 24
DISTANCE = 4.0  # of the camera, in radii of the ball


@dataclass(frozen=True)
class Setup:
    """What is rendered; the defaults are nothing special. ``copies``: how often the mesh lies in the same place."""

    exposure: float = 1.0
    light: str = "sky"
    albedo: float = 0.5
    roughness: float = 0.4
    scale: float = 1.0
    degenerate: int = 0
    copies: int = 1
    samples: int = 64
    pixels: int = PIXELS
    shadows: str = "traced"
    seed: int = 0


def cases() -> Iterator[Case]:
    """All of them."""
    linear = "the same at exposure 1, times the factor"
    for factor in (1e-20, 1e-3, 1e3, 1e6, 1e20):
        what = "radiance; gradient in albedo"
        yield Case(GROUP, f"exposure {factor:g}", what, linear, 1e-4, lambda f=factor: _exposed(f), 1e-4)
    yield Case(GROUP, "black light", "radiance; gradient in log radiance", "0", 0.0, lambda: _black(), 0.0)
    for light in ("sun", "pole"):
        what, reference = "diffuse radiance; gradient in albedo", "linear in the albedo"
        extreme = f"all light in one texel of 1e6 ({light})"
        yield Case(GROUP, extreme, what, reference, 1e-4, lambda name=light: _linear_in_albedo(name), 1e-4)
    yield Case(GROUP, "albedo 0", "diffuse radiance", "0", 0.0, lambda: _furnace(0.0))
    yield Case(GROUP, "albedo 1 in a white furnace", "diffuse radiance", "1 (1.5 % noise)", 0.015, lambda: _furnace(1.0))
    for roughness in (MIN_ROUGHNESS, 1.0):
        extreme = f"roughness {roughness:g} in a white furnace"
        reference = "the lobe's directional albedo (1 % noise)"
        yield Case(GROUP, extreme, "specular radiance", reference, 0.02, lambda r=roughness: _specular(r))
    extreme = "albedo 1 and 100 bounces in an open box in a white furnace"
    yield Case(GROUP, extreme, "diffuse radiance; gradient in albedo", "1; finite", 0.02, _white_box)
    for factor in (1e-20, 1e20):
        what = "radiance of an open box with 3 bounces"
        yield Case(GROUP, f"exposure {factor:g}", what, linear, 1e-4, lambda f=factor: _exposed_box(f))
    same = "the same at scale 1"
    for scale in (1e-4, 1e4):
        yield Case(GROUP, f"mesh and camera at scale {scale:g}", "mean radiance", same, 2e-3, lambda s=scale: _scaled(s))
    plain = "the same without them"
    yield Case(GROUP, "100 triangles without area", "radiance", plain, 1e-6, lambda: _like_plain(Setup(degenerate=100)))
    yield Case(GROUP, "every triangle twice in the same place", "mean radiance", plain, 2e-3, lambda: _mean_like_plain(copies=2))
    yield Case(GROUP, "an image of one pixel", "radiance", "finite", 1e6, lambda: _finite(Setup(pixels=1)))
    yield Case(GROUP, "a camera that sees nothing", "radiance", "0", 0.0, _nothing_seen)
    what, reference = "mean of 64 renders", "128 samples (2 % noise)"
    yield Case(GROUP, "one sample a pixel (two: light and BRDF)", what, reference, 0.02, _few_samples)


def _ball(setup: Setup) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=3)
    faces = np.concatenate([ball.faces] * setup.copies + [np.zeros((setup.degenerate, 3), int)])
    vertices = np.asarray(ball.vertices, np.float32)
    uv = np.full((len(vertices), 2), 0.5, np.float32)
    return Mesh(setup.scale * vertices, faces.astype(np.int32), vertices, uv)


def _light(setup: Setup) -> Tensor:
    radiance = torch.ones(32, 64, 3)
    if setup.light == "sky":
        radiance[:16] *= torch.tensor([2.0, 3.0, 4.0])
    if setup.light in ("sun", "pole"):
        radiance[:] = 0.01
        radiance[(10, 20) if setup.light == "sun" else (0, 0)] = 1e6
    if setup.light == "black":
        radiance[:] = 0
    return setup.exposure * radiance


def _scene(setup: Setup, toward: float = -1.0) -> tuple[Renderer, GBuffer]:
    mesh = _ball(setup)
    to_world = np.eye(4)
    to_world[2, 3] = -toward * DISTANCE * setup.scale
    focal = 0.5 * setup.pixels * DISTANCE / 1.2  # the ball fills five sixths of the image
    centre = 0.5 * setup.pixels
    camera = Camera(to_world, (focal, focal), (centre, centre), setup.pixels, setup.pixels)
    stage = Stage(mesh, CPU)
    return stage.renderer(shadows=setup.shadows, coat="added"), stage.gbuffer([camera], 2)


def _render(setup: Setup, material: Material | None = None, radiance: Tensor | None = None) -> PixelRadiance:
    renderer, gbuffer = _scene(setup)
    material = material or _material(setup)
    light = SampledLight.of(_light(setup) if radiance is None else radiance, uniform_fraction=0.2)
    pixels = torch.arange(len(gbuffer.pixel))
    generator = torch.Generator().manual_seed(setup.seed)
    return renderer.render_pixels(gbuffer, pixels, material, light, setup.samples, generator)


def _material(setup: Setup, *, gradient: bool = False) -> Material:
    albedo, roughness = torch.full((4, 4, 3), setup.albedo), torch.full((4, 4, 1), setup.roughness)
    return Material(albedo.requires_grad_(gradient), roughness)


def _with_gradient(setup: Setup) -> tuple[PixelRadiance, Tensor]:
    material = _material(setup, gradient=True)
    rendered = _render(setup, material)
    (gradient,) = torch.autograd.grad(rendered.radiance.mean(), material.albedo)
    return rendered, gradient


def _exposed(factor: float) -> Measured:
    (plain, slope), (exposed, steep) = _with_gradient(Setup()), _with_gradient(Setup(exposure=factor))
    wanted = plain.radiance.detach().double() * factor
    error = deviation(exposed.radiance.detach(), wanted, 1e-3 * float(wanted.max()))
    return Measured(error, deviation(steep, slope.double() * factor), finite=all_finite(exposed.radiance, steep))


def _black() -> Measured:
    log_light = torch.full((32, 64, 3), -torch.inf).requires_grad_(True)
    rendered = _render(Setup(), radiance=torch.exp(log_light))
    (gradient,) = torch.autograd.grad(rendered.radiance.mean(), log_light)
    largest = float(rendered.radiance.detach().abs().max())
    return Measured(largest, float(gradient.abs().max()), finite=all_finite(rendered.radiance, gradient))


def _linear_in_albedo(light: str) -> Measured:
    setup = Setup(light=light)
    material = _material(setup, gradient=True)
    rendered = _render(setup, material)
    (gradient,) = torch.autograd.grad(rendered.diffuse.sum(), material.albedo)
    twice = _render(setup, Material(2 * material.albedo.detach(), material.roughness))
    diffuse = rendered.diffuse.detach()
    error = deviation(twice.diffuse, 2 * diffuse, 1e-6 * float(diffuse.max()))
    closed_form = diffuse.double().sum(0) / setup.albedo
    return Measured(error, deviation(gradient.sum((0, 1)), closed_form), finite=all_finite(rendered.radiance, gradient))


def _furnace(albedo: float) -> Measured:
    setup = Setup(albedo=albedo, light="white", samples=256)
    rendered = _render(setup)
    mean = rendered.diffuse.sum() / (rendered.albedo.sum() / albedo if albedo else 1.0)
    return Measured(abs(float(mean) - albedo), finite=all_finite(rendered.radiance))


def _specular(roughness: float) -> Measured:
    setup = Setup(roughness=roughness, light="white", samples=256, albedo=1.0, shadows="none")
    rendered = _render(setup)
    renderer, gbuffer = _scene(setup)
    hit = gbuffer.face >= 0
    points = renderer.surface(gbuffer.face[hit].long(), gbuffer.barycentric[hit], gbuffer.origin.expand(int(hit.sum()), 3))
    cosine = dot(points.normal, points.view)
    expected = (1 - passed_by_coat(torch.full_like(cosine, roughness), cosine)).mean()
    mean = rendered.specular.sum() / rendered.albedo.sum()
    return Measured(deviation(mean, expected), finite=all_finite(rendered.specular))


def _box(radiance: Tensor, albedo: Tensor, bounces: int) -> Tensor:
    """Diffuse radiance (P, 3) of the inside of a box without a lid, seen from above."""
    corners = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
    sides = [(0, 1, 3, 2), (0, 4, 5, 1), (1, 5, 7, 3), (3, 7, 6, 2), (2, 6, 4, 0)]  # counter-clockwise from inside
    vertices = corners[np.array(sides).reshape(-1)]
    faces = np.array([[4 * i + j for j in triangle] for i in range(5) for triangle in ((0, 1, 2), (0, 2, 3))], np.int32)
    edges = vertices[1::4] - vertices[0::4], vertices[3::4] - vertices[0::4]
    normals = np.repeat(np.cross(*edges) / 4, 4, axis=0).astype(np.float32)
    tile = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    uv = np.concatenate([(tile * 0.9 + 0.05 + (i % 3, i // 3)) / 3 for i in range(5)]).astype(np.float32)
    mesh = Mesh(vertices, faces, normals, uv)
    to_world = np.eye(4)
    to_world[2, 3] = 6.0
    camera = Camera(to_world, (3.0 * PIXELS, 3.0 * PIXELS), (0.5 * PIXELS, 0.5 * PIXELS), PIXELS, PIXELS)
    stage = Stage(mesh, CPU)
    with tempfile.TemporaryDirectory() as cache:
        operators = bake_interreflection(mesh, stage.surface, stage.rays, bounces, Path(cache))
    shadows = TracedShadows(stage.rays, stage.surface.offset)
    renderer, gbuffer = Renderer(stage.surface, shadows, interreflection=operators), stage.gbuffer([camera], 1)
    material = Material(albedo, torch.full((1, 1, 1), 0.5))
    generator = torch.Generator().manual_seed(0)
    pixels = torch.arange(len(gbuffer.pixel))
    return renderer.render_pixels(gbuffer, pixels, material, SampledLight.of(radiance), 512, generator).diffuse


def _white_box() -> Measured:
    albedo = torch.ones(1, 1, 3, requires_grad=True)
    diffuse = _box(torch.ones(16, 32, 3), albedo, bounces=100)
    (gradient,) = torch.autograd.grad(diffuse.mean(), albedo)
    mean = diffuse.detach().mean()
    return Measured(deviation(mean, torch.ones(())), finite=all_finite(diffuse, gradient))


def _exposed_box(factor: float) -> Measured:
    radiance, albedo = _light(Setup()), torch.full((1, 1, 3), 0.8)
    plain, exposed = (_box(light, albedo, bounces=3) for light in (radiance, factor * radiance))
    wanted = plain.double() * factor
    return Measured(deviation(exposed, wanted, 1e-3 * float(wanted.max())), finite=all_finite(exposed))


def _scaled(scale: float) -> Measured:
    found, plain = _render(Setup(scale=scale)), _render(Setup())
    return Measured(deviation(found.radiance.mean(0), plain.radiance.mean(0)), finite=all_finite(found.radiance))


def _like_plain(setup: Setup) -> Measured:
    found, plain = _render(setup), _render(Setup())
    return Measured(deviation(found.radiance, plain.radiance, 1e-6), finite=all_finite(found.radiance))


def _mean_like_plain(**changes: int) -> Measured:
    found, plain = _render(replace(Setup(), **changes)), _render(Setup())
    return Measured(deviation(found.radiance.mean(0), plain.radiance.mean(0)), finite=all_finite(found.radiance))


def _finite(setup: Setup) -> Measured:
    rendered = _render(setup)
    return Measured(float(rendered.radiance.abs().max()), finite=all_finite(rendered.radiance))


def _nothing_seen() -> Measured:
    setup = Setup()
    renderer, gbuffer = _scene(setup, toward=1.0)
    generator = torch.Generator().manual_seed(0)
    images = renderer.render_images(gbuffer, _material(setup), SampledLight.of(_light(setup)), 8, generator)
    return Measured(float(images["radiance"].abs().max()), finite=all_finite(images["radiance"]))


def _few_samples() -> Measured:
    few = torch.stack([_render(Setup(samples=1, seed=seed)).radiance.mean(0) for seed in range(64)]).mean(0)
    return Measured(deviation(few, _render(Setup(samples=128, seed=1000)).radiance.mean(0)), finite=all_finite(few))
