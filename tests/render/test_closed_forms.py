"""Whole pictures against closed forms (a mirror ball, a ball in a constant light, two facing planes) and against brute force.

The closed forms start from the camera's matrix and the shapes' equations; they share no code with the renderer.
"""

import numpy as np
import pytest
import textbook
import torch
from means import assert_same_mean
from scipy.stats import norm
from shapes import camera_at, plate, sphere, together, unit_rays
from stage import Stage

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.render.renderer import PixelRadiance
from ia_bench.scenes.scene import Camera

pytestmark = pytest.mark.verify

REPEATS = 24


def unit_ball(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where these rays meet the unit ball: normals (H W, 3), NaN for a miss, and directions toward the camera."""
    origin, direction = camera.to_world[:3, 3], unit_rays(camera).reshape(-1, 3)
    along = direction @ origin
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(along**2 - origin @ origin + 1)
    return origin + distance[:, None] * direction, -direction


def repeats(stage: Stage, pixels: torch.Tensor, material: Material, radiance: torch.Tensor, samples: int) -> PixelRadiance:
    """REPEATS independent estimates of some pixels: fields (REPEATS, P, 3) in float64."""
    drawn = stage.estimate(pixels.repeat(REPEATS), material, SampledLight.of(radiance), samples, seed=1)
    parts = (drawn.diffuse, drawn.specular, drawn.albedo)
    return PixelRadiance(*(part.double().reshape(REPEATS, len(pixels), 3) for part in parts))


def place_in_map(direction: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column (...) of directions (..., 3) in a lat-long map, with their fractions."""
    row = np.arccos(direction[..., 2].clip(-1, 1)) / np.pi * height
    return row, (np.pi - np.arctan2(direction[..., 1], direction[..., 0])) / (2 * np.pi) * width


def grey(roughness: float) -> Material:
    return Material(torch.full((1, 1, 3), 0.5), torch.full((1, 1, 1), roughness))


@pytest.fixture(scope="module")
def ball() -> Stage:
    """A unit ball of 82 000 triangles: at the cosines used below, their normals are those of the ball to 3e-4."""
    return Stage(sphere(6), [camera_at((2.1, -3.0, 1.4), pixels=40)])


# ---------------------------------------------------------------- spherical mirror
def test_spherical_mirror_shows_the_light_where_it_is(ball: Stage) -> None:
    """At the smallest roughness a pixel shows the texel that it mirrors, times Schlick's reflectance.

    Pixels that mirror a direction near the border of a texel are left out: within 0.06 (a lobe's tail has 0.1 % beyond that).
    """
    camera = camera_at((2.1, -3.0, 1.4), pixels=40)
    normal, view = unit_ball(camera)
    cosine = (normal * view).sum(-1)
    mirrored = 2 * cosine[:, None] * normal - view
    height, width = 6, 12
    light = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(2)) + 0.2

    row, column = place_in_map(mirrored, height, width)
    inside = [np.abs(place - np.round(place)) for place in (row, column)]
    sine = np.sqrt(1 - mirrored[:, 2] ** 2)
    sharp = (inside[0] * np.pi / height > 0.06) & (inside[1] * 2 * np.pi / width * sine > 0.06) & (cosine > 0.2)

    chosen = torch.nonzero(torch.from_numpy(sharp)[ball.seen.pixel])[:, 0]
    pixel = ball.seen.pixel[chosen].numpy()
    texel = row[pixel].astype(int) * width + column[pixel].astype(int)
    assert len(pixel) > 200
    assert len(np.unique(texel)) > 0.5 * height * width
    expected = light.reshape(-1, 3).double().numpy()[texel] * (0.04 + 0.96 * (1 - cosine[pixel, None]) ** 5)
    found = repeats(ball, chosen, grey(0.03), light, 64).specular.mean(0).numpy()
    np.testing.assert_allclose(found, expected, rtol=0.02)
    assert abs((found / expected).mean() - 1) < 2e-3


# ---------------------------------------------------------------- a ball in a constant light
def reflected_share(cos_o: np.ndarray, roughness: float) -> np.ndarray:
    """Share of a constant light that the specular lobe reflects toward each cosine, by Gauss-Legendre over the hemisphere."""
    node, weight = np.polynomial.legendre.leggauss(200)
    cos_i, share = (node[:, None] + 1) / 2, weight[:, None] / 2
    azimuth = (np.arange(256) + 0.5) * (2 * np.pi / 256)
    incident = toward(cos_i, azimuth)
    found = [(textbook.specular(np.eye(3)[2], toward(cosine, 0.0), incident, roughness) * share).sum() for cosine in cos_o]
    return np.array(found) * 2 * np.pi / len(azimuth)


def toward(cosine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Directions (..., 3) of which z is this cosine."""
    sine = np.sqrt(1 - cosine**2)
    return np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine), -1)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_ball_in_a_constant_light(ball: Stage, roughness: float) -> None:
    """t-test of every pixel: diffuse is albedo times radiance, specular the share that the lobe reflects."""
    normal, view = unit_ball(camera_at((2.1, -3.0, 1.4), pixels=40))
    cosine = (normal * view).sum(-1)
    chosen = torch.nonzero(torch.from_numpy(cosine > 0.3)[ball.seen.pixel])[:, 0][::3]
    expected = reflected_share(cosine[ball.seen.pixel[chosen].numpy()], roughness)
    radiance = torch.tensor([0.5, 1.0, 2.0])
    found = repeats(ball, chosen, grey(roughness), radiance.expand(16, 32, 3).contiguous(), 256)
    mean = np.ones((len(chosen), 1)) * radiance.double().numpy()
    # All channels share their samples, so one of them is tested.
    assert_same_mean(found.diffuse[..., 1].numpy(), (0.5 * mean)[None, :, 1], resolution=1e-3)
    assert_same_mean(found.specular[..., 1].numpy(), (expected[:, None] * mean)[None, :, 1], resolution=2e-3)
    for part in (found.diffuse, found.specular):
        torch.testing.assert_close(part / radiance, part[..., 1:2].expand_as(part), rtol=1e-5, atol=0)


# ---------------------------------------------------------------- facing planes
def blocked_share(x: np.ndarray, y: np.ndarray, half: float, gap: float) -> np.ndarray:
    """Form factor from points (x, y) to the parallel square of side 2 ``half`` at distance ``gap`` (Howell, B-4).

    It is the sum over the four rectangles that have a corner above the point; their sides count negative beyond the edge.
    """
    total = np.zeros_like(x)
    for a in ((half - x) / gap, (half + x) / gap):
        for b in ((half - y) / gap, (half + y) / gap):
            total += a / np.sqrt(1 + a**2) * np.arctan(b / np.sqrt(1 + a**2))
            total += b / np.sqrt(1 + b**2) * np.arctan(a / np.sqrt(1 + b**2))
    return total / (2 * np.pi)


@pytest.mark.parametrize("above", [True, False], ids=["the lower, from between", "the upper, from between"])
def test_facing_planes_block_their_form_factor(above: bool) -> None:
    """Two parallel squares in a constant light, direct light alone: albedo L (1 - form factor) at every pixel of either."""
    half, gap, inside = 1.0, 1.6, 0.75
    mesh = together(plate(half, height=-gap / 2), plate(half, height=gap / 2))
    camera = camera_at((0.0, 0.0, inside if above else -inside), pixels=15, field_of_view=66.0)
    stage = Stage(mesh, [camera])
    assert len(stage.every) == 15 * 15  # the plate fills the picture

    direction = unit_rays(camera).reshape(-1, 3)
    seen = camera.to_world[:3, 3] + direction * ((gap / 2 + inside) / np.abs(direction[:, 2]))[:, None]
    assert np.abs(seen[:, :2]).max() > 0.9 * half
    expected = 0.5 * 2.0 * (1 - blocked_share(seen[:, 0], seen[:, 1], half, gap))
    assert expected.min() < 0.75 < 0.9 < expected.max() / 0.85  # shadows differ over the plate
    light = torch.full((16, 32, 3), 2.0)
    found = repeats(stage, stage.every, grey(1.0), light, 128).diffuse[..., 0]
    assert_same_mean(found.numpy(), expected[None], resolution=1e-3)


# ---------------------------------------------------------------- brute force
FALSE_ALARM = 1e-3
"""Probability that the test below fails for a correct estimator (Sidak over all pixels, channels and parts)."""

DIRECTIONS, ESTIMATES, PIXELS = 8000, 300, 120


def brute_force(stage: Stage, pixels: torch.Tensor, material: Material, radiance: np.ndarray) -> np.ndarray:
    """Per direction: 4 pi L V f cos for uniform directions, (P, D, 2, 3) diffuse and specular, in numpy float64."""
    points = stage.points(pixels)
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(len(pixels), DIRECTIONS, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    blocked = stage.rays.occluded(stage.surface.lifted(points), torch.from_numpy(direction).float())
    normal, view = points.normal.double().numpy()[:, None], points.view.double().numpy()[:, None]
    roughness = fetch(material.roughness, points.uv).double().numpy()
    albedo = fetch(material.albedo, points.uv).double().numpy()[:, None]

    height, width, _ = radiance.shape
    row, column = place_in_map(direction, height, width)
    row, column = row.clip(0, height - 1).astype(int), column.clip(0, width - 1).astype(int)
    cos_i = (direction * normal).sum(-1)
    specular = textbook.specular(normal, view, direction, roughness)
    visible = (~blocked.numpy() & (cos_i > 0))[..., None]
    incoming = 4 * np.pi * radiance[row, column] * visible
    return np.stack([incoming * albedo / np.pi * cos_i[..., None], incoming * specular[..., None]], 2)


def test_estimator_agrees_with_brute_force(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    """z-test per pixel, channel and part of MIS against uniform directions over the sphere, shadows included."""
    radiance = LatLongEnvironment(soft_light).latlong(16)
    light = SampledLight.of(radiance)
    pixels = torch.randperm(len(tiny_stage.seen.pixel), generator=torch.Generator().manual_seed(6))[:PIXELS]
    flat = tiny_stage.points(pixels)
    pixels = pixels[(flat.normal * flat.view).sum(-1) > 0.05]  # brute force has no answer at grazing either
    assert len(pixels) > 0.9 * PIXELS

    wanted = brute_force(tiny_stage, pixels, tiny_material, radiance.double().numpy())
    generator = torch.Generator().manual_seed(7)
    renderer = tiny_stage.renderer()
    found = []
    for _ in range(ESTIMATES // 20):
        part = renderer.render_pixels(tiny_stage.seen, pixels.repeat(20), tiny_material, light, 16, generator)
        found.append(torch.stack([part.diffuse, part.specular], 1).reshape(20, len(pixels), 2, 3))
    ours = torch.cat(found).double().numpy()

    error = np.sqrt(wanted.var(1, ddof=1) / DIRECTIONS + ours.var(0, ddof=1) / ESTIMATES)
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


# ---------------------------------------------------------------- convergence
def test_error_falls_as_the_root_of_the_samples(tiny_stage: Stage, tiny_material: Material, tiny_sun: torch.Tensor) -> None:
    """Slope of log error over log samples from 8 to 512 independent samples: -1/2 (-0.490 +- 0.005 over ten seeds).

    The error is that against the mean of as many other estimates, so that an estimator that is biased by what it sees few of
    would flatten out.
    """
    pixels = torch.randperm(len(tiny_stage.seen.pixel), generator=torch.Generator().manual_seed(0))[:100]
    drawn = tiny_stage.estimate(pixels.repeat(2048), tiny_material, SampledLight.of(tiny_sun), 8, seed=2)
    estimates = (drawn.diffuse + drawn.specular).reshape(2048, len(pixels), 3).double().numpy()
    truth, counts = estimates[1024:].mean(0), np.array([1, 4, 16, 64])
    means = [estimates[:1024].reshape(-1, n, *truth.shape).mean(1) for n in counts]
    errors = [np.sqrt((((mean - truth) / (truth + truth.mean())) ** 2).mean()) for mean in means]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(slope + 0.5) < 0.04, f"slope {slope:.3f} of {errors}"
