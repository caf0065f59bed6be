"""The Monte-Carlo estimator against closed forms, and against brute force that shares no formula with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.stats import norm
from shapes import camera_at, disk, plate, sphere, together
from stage import Stage

from ia_bench.light.latlong import SampledLight, normal_bin, resize_light
from ia_bench.material.textures import Material, fetch
from ia_bench.render.estimator import lattice, sample_directions, shade_directions

pytestmark = pytest.mark.verify

RADIANCE = torch.tensor([0.5, 1.0, 2.0])
ALBEDO = torch.tensor([0.2, 0.5, 0.9])


def constant(roughness: float = 1.0) -> Material:
    return Material(ALBEDO.expand(4, 4, 3).contiguous(), torch.full((4, 4, 1), roughness))


def constant_light(height: int = 8) -> SampledLight:
    return SampledLight.of(RADIANCE.expand(height, 2 * height, 3).contiguous())


# ---------------------------------------------------------------- samples
@pytest.mark.parametrize(("points", "count"), [(1, 16), (4, 8), (9, 3)])
def test_lattice_is_uniform_and_stratified(points: int, count: int) -> None:
    """Over random shifts every entry is uniform; in each pixel the first coordinate has one entry per stratum."""
    shift = torch.rand(4000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    samples = lattice(shift, points, count)
    assert samples.shape == (4000, points, count, 3)
    assert 0 <= float(samples.min()) <= float(samples.max()) < 1
    assert float(samples.float().max()) < 1
    strata = (samples[..., 0].reshape(4000, -1) * points * count).long().sort(dim=1).values
    assert torch.equal(strata, torch.arange(points * count).expand(4000, -1))
    deviation = samples.mean(0) - 0.5  # of 4000 uniform numbers: sigma = 1 / sqrt(12 * 4000)
    assert float(deviation.abs().max()) < 5 / math.sqrt(12 * 4000)
    if count > 1:  # each point of the pixel alone spans the whole range
        spread = samples[..., 0].amax(2) - samples[..., 0].amin(2)
        assert float(spread.min()) > 1 - 2 / count


def test_weights_are_the_balance_heuristic() -> None:
    """For a black-box check: 1 / weight is n (p_light + p_brdf) >= n p_light, and nothing counts below the horizon."""
    generator = torch.Generator().manual_seed(1)
    normal = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * torch.randn(50, 3, generator=generator), dim=-1)
    light = SampledLight.of(torch.rand(8, 16, 3, generator=generator))
    draws = torch.rand(2, 50, 12, 3, dtype=torch.float64, generator=generator)
    direction, texel, weight = sample_directions(
        normal, view, torch.full((50, 1), 0.4), *draws, light.sampler
    )
    assert direction.shape == (50, 24, 3)
    torch.testing.assert_close(direction.norm(dim=-1), torch.ones(50, 24), atol=1e-5, rtol=0)
    above = (direction * normal[:, None]).sum(-1) > 0
    assert (weight[..., 0] > 0).equal(above)
    density = light.sampler.density(normal_bin(normal)[:, None], texel)
    assert (weight[..., 0] * 12 * density <= 1 + 1e-5).all()


# ---------------------------------------------------------------- closed forms
@pytest.mark.parametrize("side", [1, 2])
def test_lambertian_sphere_in_a_constant_light(side: int) -> None:
    """Diffuse radiance = albedo * L wherever the pixel is covered, coverage times that at the edge."""
    stage = Stage.of(sphere(3), [camera_at((2.0, -3.0, 1.0), pixels=24)], side)
    images = stage.renderer(shadows=False).render_images(
        stage.gbuffer, constant(), constant_light(), 256, torch.Generator().manual_seed(2)
    )
    coverage = stage.gbuffer.coverage()[..., None]
    expected = coverage * ALBEDO * RADIANCE
    inside = coverage[..., 0] == 1
    error = (images["diffuse"] / expected - 1)[inside]
    assert int(inside.sum()) > 150
    assert float(error.abs().max()) < 0.3
    assert float(error.mean().abs()) < 0.005  # about 200 pixels of 3 % each
    torch.testing.assert_close(images["albedo"], coverage * ALBEDO)
    torch.testing.assert_close(images["radiance"], images["diffuse"] + images["specular"])
    assert (images["radiance"][coverage[..., 0] == 0] == 0).all()
    if side == 2:
        edge = (coverage[..., 0] > 0) & ~inside
        assert float((images["diffuse"].sum(-1) / expected.sum(-1) - 1)[edge].mean().abs()) < 0.03


def test_shadow_of_a_disk() -> None:
    """A small patch under a coaxial disk: the form factor R^2 / (R^2 + h^2) of its light is blocked."""
    radius, height = 0.7, 0.6
    mesh = together(plate(0.01), disk(radius, height=height))
    camera = camera_at((0.3, 0.0, 0.08), pixels=16, field_of_view=2.0)  # from the side, below the disk
    stage = Stage.of(mesh, [camera])
    patch = torch.nonzero(stage.gbuffer.face[:, 0] < 2)[:, 0]
    assert len(patch) > 50
    arguments = (constant(), constant_light(32), 512, torch.Generator().manual_seed(3))
    shadowed = stage.renderer().render_pixels(stage.gbuffer, patch, *arguments)
    open_sky = 1 - radius**2 / (radius**2 + height**2)
    expected = ALBEDO * RADIANCE * open_sky
    torch.testing.assert_close(shadowed.diffuse.mean(0), expected, rtol=0.01, atol=0)
    lit = stage.renderer(shadows=False).render_pixels(stage.gbuffer, patch, *arguments)
    torch.testing.assert_close(lit.diffuse.mean(0), ALBEDO * RADIANCE, rtol=0.01, atol=0)


@pytest.mark.parametrize("uniform_fraction", [0.0, 0.5])
def test_a_black_light_gives_black(uniform_fraction: float) -> None:
    stage = Stage.of(sphere(1), [camera_at((2.0, -3.0, 1.0), pixels=8)])
    light = SampledLight.of(torch.zeros(4, 8, 3), uniform_fraction=uniform_fraction)
    images = stage.renderer().render_images(stage.gbuffer, constant(), light, 8, torch.Generator().manual_seed(4))
    assert float(images["radiance"].abs().max()) == 0
    assert float(images["albedo"].max()) > 0


# ---------------------------------------------------------------- brute force
FALSE_ALARM = 1e-3
"""Probability that the test below fails for a correct estimator (Sidak over all pixels, channels and parts)."""

DIRECTIONS, REPEATS, PIXELS = 8000, 300, 120


def brute_force(stage: Stage, pixels: torch.Tensor, material: Material, radiance: np.ndarray) -> np.ndarray:
    """Per direction: 4 pi L V f cos for uniform directions, (P, D, 2, 3) diffuse and specular, in numpy float64."""
    points = stage.points(pixels)
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(len(pixels), DIRECTIONS, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    origin = (points.position + stage.surface.offset * points.geometric)[:, None].expand(-1, DIRECTIONS, 3)
    blocked = stage.rays.occluded(
        origin.reshape(-1, 3).contiguous(), torch.from_numpy(direction).float().reshape(-1, 3)
    )
    normal, view = points.normal.double().numpy()[:, None], points.view.double().numpy()[:, None]
    roughness = fetch(material.roughness, points.uv).double().numpy()
    albedo = fetch(material.albedo, points.uv).double().numpy()[:, None]

    height, width, _ = radiance.shape
    row = np.clip(np.arccos(np.clip(direction[..., 2], -1, 1)) / np.pi * height, 0, height - 1).astype(int)
    phi = np.arctan2(direction[..., 1], direction[..., 0])
    column = np.clip((np.pi - phi) / (2 * np.pi) * width, 0, width - 1).astype(int)

    cos_i, cos_o = (direction * normal).sum(-1), (view * normal).sum(-1)
    half = direction + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h, cos_d = (half * normal).sum(-1), (half * view).sum(-1)
    alpha2 = roughness**4
    tan2_i, tan2_o = 1 / cos_i**2 - 1, 1 / cos_o**2 - 1
    smith = 2 / (np.sqrt(1 + alpha2 * tan2_i) + np.sqrt(1 + alpha2 * tan2_o))
    ggx = alpha2 / (np.pi * (cos_h**2 * (alpha2 - 1) + 1) ** 2)
    specular = ggx * smith * (0.04 + 0.96 * (1 - cos_d) ** 5) / (4 * cos_o)
    visible = (~blocked.numpy().reshape(cos_i.shape) & (cos_i > 0))[..., None]
    incoming = 4 * np.pi * radiance[row, column] * visible
    return np.stack([incoming * albedo / np.pi * cos_i[..., None], incoming * specular[..., None]], 2)


def test_estimator_agrees_with_brute_force(
    tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor
) -> None:
    """z-test per pixel, channel and part of MIS against uniform directions over the sphere, shadows included."""
    radiance = resize_light(soft_light.numpy(), 16)
    light = SampledLight.of(torch.from_numpy(radiance))
    pixels = torch.randperm(len(tiny_stage.gbuffer.pixel), generator=torch.Generator().manual_seed(6))[:PIXELS]
    flat = tiny_stage.points(pixels)
    pixels = pixels[(flat.normal * flat.view).sum(-1) > 0.05]  # brute force has no answer at grazing either
    assert len(pixels) > 0.9 * PIXELS

    wanted = brute_force(tiny_stage, pixels, tiny_material, radiance.astype(np.float64))
    generator = torch.Generator().manual_seed(7)
    renderer = tiny_stage.renderer()
    found = []
    for _ in range(REPEATS // 20):
        part = renderer.render_pixels(tiny_stage.gbuffer, pixels.repeat(20), tiny_material, light, 16, generator)
        found.append(torch.stack([part.diffuse, part.specular], 1).reshape(20, len(pixels), 2, 3))
    ours = torch.cat(found).double().numpy()

    error = np.sqrt(wanted.var(1, ddof=1) / DIRECTIONS + ours.var(0, ddof=1) / REPEATS)
    difference = ours.mean(0) - wanted.mean(1)
    lit = wanted.mean(1) > 1e-6
    assert lit.mean() > 0.95
    assert np.median((error / wanted.mean(1))[lit]) < 0.05  # so a bias of 25 % in one pixel is seen ...
    z = np.abs(difference / error)[lit]
    limit = norm.isf((1 - (1 - FALSE_ALARM) ** (1 / z.size)) / 2)
    assert z.max() < limit, f"largest |z| {z.max():.2f} of {z.size}, limit {limit:.2f}"
    for part in range(2):  # ... and one of 5 % in all of them: pixels are independent of each other
        total = difference[:, part].mean(-1).sum() / np.sqrt((error[:, part].mean(-1) ** 2).sum())
        assert abs(total) < norm.isf(FALSE_ALARM / 4)
        assert np.sqrt((error[:, part].mean(-1) ** 2).sum()) / wanted[:, :, part].mean((1, 2)).sum() < 0.02


def test_light_sampling_share_does_not_move_the_mean(
    tiny_stage: Stage, tiny_material: Material, tiny_sun: torch.Tensor
) -> None:
    """Under a sun: half of the light samples spread evenly give the same picture as none."""
    pixels = torch.arange(0, len(tiny_stage.gbuffer.pixel), 9).repeat(30)
    renderer = tiny_stage.renderer()
    means, errors = [], []
    for seed, share in enumerate((0.0, 0.5)):
        light = SampledLight.of(tiny_sun, uniform_fraction=share)
        value = renderer.render_pixels(
            tiny_stage.gbuffer, pixels, tiny_material, light, 16, torch.Generator().manual_seed(seed)
        ).radiance.double()
        values = value.reshape(30, -1, 3).mean((1, 2))
        means.append(float(values.mean()))
        errors.append(float(values.std()) / math.sqrt(30))
    assert abs(means[0] - means[1]) < 4 * math.hypot(*errors)
    assert math.hypot(*errors) < 0.02 * means[0]


# ---------------------------------------------------------------- convergence
def spread(stage: Stage, material: Material, light: SampledLight, samples: int) -> float:
    """Root mean square of half the difference of two estimates, over the pixels, tone-mapped so that no pixel rules."""
    pixels = torch.arange(len(stage.gbuffer.pixel))
    pair = [
        stage.renderer().render_pixels(
            stage.gbuffer, pixels, material, light, samples, torch.Generator().manual_seed(s)
        )
        for s in (8, 9)
    ]
    return float(((pair[0].radiance - pair[1].radiance) ** 2).mean().sqrt())


def test_error_falls_with_samples(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """Slope of log error over log samples: -1/2 for independent samples, steeper for the lattice, never flatter."""
    samples = np.array([4, 16, 64, 256])
    light = SampledLight.of(soft_light)
    errors = [spread(tiny_stage, tiny_material, light, int(n)) for n in samples]
    slope = np.polyfit(np.log(samples), np.log(errors), 1)[0]
    assert -1.0 < slope < -0.45, f"slope {slope:.2f} of {errors}"


def test_passes_of_a_picture_share_one_lattice(
    tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor
) -> None:
    """Passes of 32 samples: independent ones would halve the error with four times as many, parts of a lattice do better."""
    light = SampledLight.of(soft_light)

    def error(samples: int, seed: int) -> float:
        pair = [
            tiny_stage.renderer().render_images(
                tiny_stage.gbuffer, tiny_material, light, samples, torch.Generator().manual_seed(s)
            )
            for s in (seed, seed + 1)
        ]
        return float(((pair[0]["radiance"] - pair[1]["radiance"]) ** 2).mean().sqrt())

    assert 0.2 < error(128, 10) / error(32, 12) < 0.45


# ---------------------------------------------------------------- gradients
def test_gradients_against_finite_differences_with_the_samples_held() -> None:
    """gradcheck in float64: albedo, roughness and log radiance, the directions and weights of one draw fixed."""
    generator = torch.Generator().manual_seed(13)
    count, height, width = 6, 3, 6
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.5 * torch.randn(count, 3, generator=generator), dim=-1)
    uv = torch.rand(count, 2, generator=generator)
    albedo, roughness = torch.rand(3, 3, 3, generator=generator), 0.2 + 0.7 * torch.rand(3, 3, 1, generator=generator)
    log_light = torch.randn(height * width, 3, generator=generator)
    light = SampledLight.of(log_light.exp().reshape(height, width, 3))
    draws = torch.rand(2, count, 8, 3, dtype=torch.float64, generator=generator)
    direction, texel, weight = sample_directions(
        normal, view, fetch(roughness, uv), *draws, light.sampler
    )
    fixed = [t.double() for t in (normal, view, uv, direction)]

    def shade(albedo: torch.Tensor, roughness: torch.Tensor, log_light: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return shade_directions(*fixed, texel, weight.double(), albedo, roughness, log_light.exp())

    inputs = tuple(t.double().requires_grad_() for t in (albedo, roughness, log_light))
    assert torch.autograd.gradcheck(shade, inputs, rtol=1e-4, atol=1e-6)


def test_renderer_is_linear_in_albedo_and_light(
    tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor
) -> None:
    """With the same draws, f(x + d) - f(x) = <gradient, d> for any d: the gradients' whole path, shadows included."""
    pixels = torch.arange(0, len(tiny_stage.gbuffer.pixel), 7)
    rng = torch.Generator().manual_seed(14)
    proxy = torch.rand(len(pixels), 3, generator=rng)
    sampler = SampledLight.of(soft_light).sampler
    renderer = tiny_stage.renderer()

    def loss(albedo: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
        material = Material(albedo, tiny_material.roughness)
        draws = torch.Generator().manual_seed(15)
        part = renderer.render_pixels(tiny_stage.gbuffer, pixels, material, SampledLight(radiance, sampler), 16, draws)
        return (part.radiance * proxy).double().sum()

    albedo, radiance = tiny_material.albedo.clone().requires_grad_(), soft_light.clone().requires_grad_()
    base = loss(albedo, radiance)
    gradients = torch.autograd.grad(base, (albedo, radiance))
    for index, (value, gradient) in enumerate(zip((albedo, radiance), gradients, strict=True)):
        change = torch.rand(value.shape, generator=rng)
        moved = [albedo.detach(), radiance.detach()]
        moved[index] = moved[index] + change
        predicted = float((gradient.double() * change).sum())
        assert predicted > 0.1
        assert float(loss(*moved) - base.detach()) == pytest.approx(predicted, rel=1e-4)


def test_detached_sampling_has_an_unbiased_gradient_of_roughness() -> None:
    """The mean of the gradient over 40 000 draws is the derivative of the integral, by quadrature and differences."""
    height, width, roughness, step = 4, 8, 0.5, 1e-3
    radiance = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(16)) ** 3
    normal, view = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([math.sin(0.8), 0.0, math.cos(0.8)])

    # Midpoint rule over the sphere in (cos theta, phi), whole cells in every texel, in float64.
    fine = 96
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    z = np.concatenate(
        [a + (b - a) * (np.arange(fine) + 0.5) / fine for a, b in zip(edges[:-1], edges[1:], strict=True)]
    )
    area = np.repeat((edges[:-1] - edges[1:]) / fine, fine) * (2 * np.pi / (width * fine))
    phi = np.pi - 2 * np.pi * (np.arange(width * fine) + 0.5) / (width * fine)
    sin = np.sqrt(1 - z**2)[:, None]
    grid = np.stack([sin * np.cos(phi), sin * np.sin(phi), np.broadcast_to(z[:, None], (len(z), len(phi)))], -1)
    light = np.repeat(np.repeat(radiance.double().numpy(), fine, 0), fine, 1)

    def integral(r: float) -> float:
        alpha2, cos_i, cos_o = r**4, np.maximum(grid[..., 2], 1e-9), math.cos(0.8)
        half = grid + view.double().numpy()
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        ggx = alpha2 / (np.pi * (half[..., 2] ** 2 * (alpha2 - 1) + 1) ** 2)
        smith = 2 / (np.sqrt(1 + alpha2 * (1 / cos_i**2 - 1)) + math.sqrt(1 + alpha2 * (1 / cos_o**2 - 1)))
        fresnel = 0.04 + 0.96 * (1 - half @ view.double().numpy()) ** 5
        value = ggx * smith * fresnel / (4 * cos_o) * (grid[..., 2] > 0)
        return float((light.mean(-1) * value * area[:, None]).sum())

    expected = (integral(roughness + step) - integral(roughness - step)) / (2 * step)

    groups, draws_each = 200, 200
    texture = torch.full((1, groups, 1), roughness, requires_grad=True)
    count = groups * draws_each
    uv = torch.stack([(torch.arange(count) % groups + 0.5) / groups, torch.full((count,), 0.5)], -1)
    sampler = SampledLight.of(radiance).sampler
    uniform = torch.rand(2, count, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(17))
    points = normal.expand(count, 3), view.expand(count, 3)
    with torch.no_grad():
        direction, texel, weight = sample_directions(
            *points, torch.full((count, 1), roughness), *uniform, sampler
        )
    albedo = torch.zeros(1, 1, 3)
    _, specular, _ = shade_directions(*points, uv, direction, texel, weight, albedo, texture, radiance.reshape(-1, 3))
    (gradient,) = torch.autograd.grad(specular.mean(-1).sum() / draws_each, texture)
    means = gradient.flatten().double()
    error = float(means.std()) / math.sqrt(groups)
    assert abs(expected) > 20 * error  # so that a wrong gradient is seen
    assert abs(float(means.mean()) - expected) < 4 * error
    value = specular.detach().mean(-1).double()
    assert abs(float(value.mean()) - integral(roughness)) < 4 * float(value.std()) / math.sqrt(count)


def test_directions_carry_no_gradient(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """The diffuse part depends on roughness through the directions only, so its gradient of roughness is none."""
    roughness = tiny_material.roughness.clone().requires_grad_()
    material = Material(tiny_material.albedo, roughness)
    pixels = torch.arange(50)
    part = tiny_stage.renderer().render_pixels(
        tiny_stage.gbuffer, pixels, material, SampledLight.of(soft_light), 8, torch.Generator().manual_seed(18)
    )
    assert not part.diffuse.requires_grad
    (gradient,) = torch.autograd.grad(part.specular.sum(), roughness)
    assert float(gradient.abs().sum()) > 0
    assert torch.isfinite(gradient).all()
