"""Our renderer against Mitsuba 3: images and gradients, within the noise of both.

Needs the extra `mitsuba` and libLLVM (docs/verification.md);
skipped without them.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from means import assert_same_mean
from mitsuba_twin import MitsubaTwin, Twin, load_mitsuba, twin_scene
from shapes import bowl, camera_at

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material

pytestmark = [pytest.mark.verify, pytest.mark.slow, pytest.mark.usefixtures("own_cache")]

DIRECT = 2  # the path depth of direct light alone
BSDFS = ("diffuse", "equation2")
REPEATS, SAMPLES, PASSES = 48, 512, 8  # of each renderer; ours takes its samples in passes of 64


@pytest.fixture(scope="module")
def mi() -> Any:
    return load_mitsuba()


@pytest.fixture(scope="module")
def twin() -> Twin:
    return twin_scene()


@pytest.fixture(scope="module")
def facing(twin: Twin) -> torch.Tensor:
    """Entries of the G-buffer that are seen at a cosine above 0.1.

    At smaller ones the two treat directions between the horizons of the triangle and of its smooth normal differently.
    """
    points = twin.stage.points(twin.stage.every)
    chosen = twin.stage.every[(points.normal * points.view).sum(-1) > 0.1]
    assert len(chosen) > 0.9 * len(points.view)
    return chosen


def ours(twin: Twin, bsdf: str, pixels: torch.Tensor, leaves: dict[str, torch.Tensor], seed: int) -> torch.Tensor:
    """Radiance (P, 3) of G-buffer entries ``pixels`` from SAMPLES directions each, direct light, differentiable in ``leaves``."""
    material, light = Material(leaves["albedo"], leaves["roughness"]), SampledLight.of(leaves["light"])
    part = twin.stage.estimate(pixels.repeat(PASSES), material, light, SAMPLES // PASSES, seed)
    radiance = part.diffuse if bsdf == "diffuse" else part.radiance
    return radiance.reshape(PASSES, len(pixels), 3).mean(0)


def leaves_of(twin: Twin) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(getattr(twin, name), requires_grad=True) for name in ("albedo", "roughness", "light")}


@pytest.mark.parametrize("bsdf", BSDFS)
def test_images_agree(mi: Any, twin: Twin, facing: torch.Tensor, bsdf: str) -> None:
    """Every pixel and channel, and their sum to 0.05 %; the silhouettes are the same but for one pixel at most."""
    theirs = MitsubaTwin(mi, twin, bsdf=bsdf, max_depth=DIRECT)
    images = np.stack([theirs.image(SAMPLES, seed) for seed in range(REPEATS)]).reshape(REPEATS, -1, 3)
    covered = twin.stage.seen.coverage().numpy().ravel() > 0
    assert np.count_nonzero(covered != (images.mean((0, 2)) > 0)) <= 1
    with torch.no_grad():
        found = np.stack([ours(twin, bsdf, facing, leaves_of(twin), seed).numpy() for seed in range(REPEATS)])
    assert_same_mean(found, images[:, twin.stage.seen.pixel[facing].numpy()], resolution=5e-4)


@pytest.mark.parametrize("bsdf", BSDFS)
def test_gradients_agree(mi: Any, twin: Twin, facing: torch.Tensor, bsdf: str) -> None:
    """Of a random weighting of the pixels in every texel of albedo, roughness and light; in a texel to 1 % mostly."""
    proxy = torch.zeros(twin.camera.height * twin.camera.width, 3)
    chosen = twin.stage.seen.pixel[facing]
    proxy[chosen] = torch.rand(len(facing), 3, generator=torch.Generator().manual_seed(2))
    theirs = MitsubaTwin(mi, twin, bsdf=bsdf, max_depth=DIRECT)
    weights = proxy.reshape(twin.camera.height, twin.camera.width, 3).numpy()
    expected = [theirs.gradients(weights, SAMPLES, seed) for seed in range(REPEATS)]
    found: list[dict[str, np.ndarray]] = []
    for seed in range(REPEATS):
        leaves = leaves_of(twin)
        (ours(twin, bsdf, facing, leaves, seed) * proxy[chosen]).sum().backward()
        found.append({name: leaves[name].grad.numpy().reshape(expected[0][name].shape) for name in expected[0]})
    assert set(expected[0]) == ({"albedo", "light"} if bsdf == "diffuse" else {"albedo", "roughness", "light"})
    for name in expected[0]:
        a, b = (np.stack([gradient[name] for gradient in side]).reshape(REPEATS, -1) for side in (found, expected))
        told = np.abs(b.mean(0)) > 1e-2 * np.abs(b.mean(0)).max()  # a texel that is hardly seen has no bell curve
        assert told.mean() > 0.7  # the others are below the horizon of what is seen
        a, b = a[:, told], b[:, told]
        spread = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / REPEATS) / np.abs(b.mean(0))
        assert np.median(spread) < 1e-2
        assert_same_mean(a, b, resolution=3e-3)


BOUNCES = 2


@pytest.fixture(scope="module")
def bowl_twin(twin: Twin) -> Twin:
    """A bowl with an atlas of its own, looked into from the side: a third of what is seen has bounced in it before."""
    light = np.random.default_rng(3).random((16, 32, 3)).astype(np.float32) ** 3
    camera = camera_at((1.0, -1.5, 4.0), pixels=28, field_of_view=26.0)
    return replace(twin, mesh=bowl(share=0.6), camera=camera, light=light)


def bounced(twin: Twin, bounces: int, pixels: torch.Tensor, leaves: dict[str, torch.Tensor]) -> torch.Tensor:
    """Radiance (P, 3) of G-buffer entries ``pixels``, of the diffuse lobe, differentiable in ``leaves``."""
    material, light = Material(leaves["albedo"], leaves["roughness"]), SampledLight.of(leaves["light"])
    rendered = twin.stage.estimate(pixels.repeat(PASSES), material, light, SAMPLES, bounces=bounces)
    return rendered.diffuse.reshape(PASSES, -1, 3).mean(0)


def test_indirect_light_agrees(mi: Any, bowl_twin: Twin) -> None:
    """Two bounces of a diffuse bowl, and their gradients, by path tracing and by our baked exchange between texels.

    The exchange is not exact in every pixel, so no test of noise: 2 % of the picture in RMS, 2 % of its indirect part in the
    mean, 3 % of the gradients of albedo and light in RMS.
    """
    theirs = {depth: MitsubaTwin(mi, bowl_twin, bsdf="diffuse", max_depth=depth) for depth in (DIRECT, DIRECT + BOUNCES)}
    expected = {depth: np.mean([side.image(4 * SAMPLES, seed) for seed in range(8)], 0) for depth, side in theirs.items()}
    inside = torch.nonzero(bowl_twin.stage.points(bowl_twin.stage.every).front)[:, 0]
    assert len(inside) > 300
    seen = bowl_twin.stage.seen.pixel[inside].numpy()
    leaves = leaves_of(bowl_twin)
    found = {depth: bounced(bowl_twin, depth - DIRECT, inside, leaves) for depth in theirs}
    full, direct = (expected[depth].reshape(-1, 3)[seen] for depth in (DIRECT + BOUNCES, DIRECT))
    ours_full, ours_direct = (found[depth].detach().numpy() for depth in (DIRECT + BOUNCES, DIRECT))
    assert (full - direct).mean() > 0.2 * full.mean()
    assert (ours_full - ours_direct).mean() == pytest.approx((full - direct).mean(), rel=0.02)
    assert np.sqrt(np.mean((ours_full - full) ** 2)) < 0.02 * full.mean()
    found[DIRECT + BOUNCES].sum().backward()
    proxy = np.zeros((bowl_twin.camera.height, bowl_twin.camera.width, 3), np.float32)
    proxy.reshape(-1, 3)[seen] = 1
    gradients = theirs[DIRECT + BOUNCES].gradients(proxy, 4 * SAMPLES, 99)
    for name in ("albedo", "light"):
        ours_now, expected_now = leaves[name].grad.numpy().ravel(), gradients[name].ravel()
        assert np.linalg.norm(ours_now - expected_now) < 0.03 * np.linalg.norm(expected_now), name
