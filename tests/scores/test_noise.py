"""Two halves of a render's samples tell how noisy it is: PSNR and SSIM are then those of a picture without noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from made_up import Ball
from test_scorer import SMALL, ball_scene

from ia_bench.light.environment import Environment
from ia_bench.render.reconstruction import Quality
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera
from ia_bench.scores import comparison
from ia_bench.scores.comparison import Pair, Pairs, Predictions
from ia_bench.scores.evaluate import score
from ia_bench.scores.metrics import LEAST, Compared, psnr, ssim
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.scorer import Scorer

SIDE = 96
RANDOM = np.random.default_rng(0)
V3 = Protocol()


def picture(values: np.ndarray) -> Images:
    return Images((values * COVERAGE[..., None],), (COVERAGE,))


Metric = Callable[[Compared], float]
Compare = Callable[[Pair, Protocol, Encoding], Compared]
Y, X = np.mgrid[:SIDE, :SIDE] / SIDE
COVERAGE = (np.hypot(X - 0.5, Y - 0.5) < 0.45).astype(float)
TRUE = 0.3 + 0.1 * np.stack([np.sin(20 * X), np.cos(15 * Y), X * Y], -1)
WRONG = TRUE * (1 + 0.15 * np.cos(30 * (X + Y))[..., None])


def noisy(values: np.ndarray, noise: float = 0.03) -> Images:
    halves = [picture(values + noise * RANDOM.standard_normal(values.shape)) for _ in range(2)]
    return halves[0].averaged(halves[1])


@pytest.mark.parametrize(
    ("metric", "compare"), [(psnr, comparison.of_object), (psnr, comparison.over_white), (ssim, comparison.of_object)]
)
def test_a_noisy_picture_scores_like_one_without_noise(metric: Metric, compare: Compare) -> None:
    noise = noisy(WRONG)
    views = [Pairs(one, picture(TRUE), 0.5, "render")[0] for one in (picture(WRONG), noise, replace(noise, spread=None))]
    clean, mended, kept = (metric(compare(view, V3, "srgb")) for view in views)
    assert clean - kept > (1 if metric is psnr else 0.05)
    assert abs(mended - clean) < 0.15 * (clean - kept)


def test_of_the_noise_a_tenth_stays_and_pictures_with_less_error_are_counted() -> None:
    noise = noisy(TRUE)
    predictions, truth = (Predictions(view_synthesis=one) for one in (noise, picture(TRUE)))
    scores = score(predictions, truth, V3)
    (pair,) = Pairs(noise, picture(TRUE), 0.5, "render")
    spread = np.square(comparison.of_object(pair, V3, "srgb").spread[pair.mask]).mean()
    assert scores.metrics["view_synthesis"]["psnr"] <= -10 * np.log10(LEAST * spread) + 1e-9
    halves = picture(TRUE + 0.03), picture(TRUE - 0.03)  # whose mean is the truth: by chance far too good
    by_chance = score(Predictions(view_synthesis=halves[0].averaged(halves[1])), truth, V3)
    assert by_chance.counts["view_synthesis"]["at_noise_floor"] == 1
    assert np.isfinite(by_chance.metrics["view_synthesis"]["psnr"])
    assert "at_noise_floor" not in score(Predictions(view_synthesis=picture(WRONG)), truth, V3).counts["view_synthesis"]


def test_halves_that_are_equal_have_no_noise_and_exposures_scale_it() -> None:
    same = picture(TRUE)
    assert same.averaged(picture(TRUE)) is same
    both = noisy(TRUE)
    (spread,) = both.exposed([2.0]).spread
    np.testing.assert_allclose(spread, 2 * both.spread[0])


def test_noise_makes_no_exposure_too_small() -> None:
    """The factor of a noisy copy of the truth is 1: the power of the noise is no part of the render's."""
    (pair,) = Pairs(noisy(TRUE, 0.1), picture(TRUE), 0.5, "render")
    found = comparison.exposed(pair, V3, "linear")
    factor = np.median(found.predicted[pair.mask] / pair.predicted[pair.mask])
    assert factor == pytest.approx(1, abs=0.01)  # .95 with the noise's power


@dataclass(frozen=True)
class NoisyBall(Ball):
    """Whose renderer draws by chance, as its quality's seed says; it notes what it is asked for."""

    asked: tuple[list[Quality], ...] = ([],)
    noise: float = 0.3

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: torch.Tensor | None, quality: Quality
    ) -> Images | None:
        self.asked[0].append(quality)
        images = super().render(cameras, light=light, albedo_scale=albedo_scale, quality=quality)
        random = np.random.default_rng(quality.seed)
        drawn = (image * (1 + self.noise * random.standard_normal(image.shape)) for image in images.images)
        return Images(tuple(np.float32(one) for one in drawn), images.coverage)


HALVES = replace(SMALL, noise="subtracted")


@pytest.mark.usefixtures("mean_square_as_lpips")
def test_every_render_is_drawn_in_two_halves_of_seeds_of_their_own() -> None:
    scene, ball = ball_scene(), NoisyBall(albedo=(0.4, 0.5, 0.2), asked=([],))
    found = Scorer(scene, HALVES, torch.device("cpu")).full(ball)
    assert ball.asked[0] == [Quality(3, 9, seed) for seed in (0, 0, 0, 1, 1, 1)]  # training light, two novel ones; then again
    clean = Scorer(scene, SMALL, torch.device("cpu")).full(Ball(albedo=ball.albedo))
    plain = Scorer(scene, SMALL, torch.device("cpu")).full(replace(ball, noise=0.3 / np.sqrt(2)))
    for name in ("view_synthesis", "relighting"):
        one, two, three = (scores.metrics[name]["psnr"] for scores in (clean, found, plain))
        assert abs(one - two) < 1
        assert one - three > 1


@pytest.mark.parametrize(("lights", "seeds"), [(1, (0, 0, 1, 1)), (None, (0, 0, 0, 1, 1, 1))])
def test_a_curve_looks_at_a_view_under_the_training_light_and_some_novel_ones(lights: int | None, seeds: tuple[int, ...]) -> None:
    ball = NoisyBall(albedo=(0.4, 0.5, 0.2), asked=([],))
    found = Scorer(ball_scene(), replace(HALVES, curve_samples=8, curve_lights=lights), torch.device("cpu")).quick(ball)
    assert ball.asked[0] == [Quality(3, 4, seed) for seed in seeds]
    assert None not in found.values()


@pytest.mark.usefixtures("mean_square_as_lpips")
def test_what_is_drawn_without_chance_scores_as_ever() -> None:
    scene, ball = ball_scene(), NoisyBall(albedo=(0.45, 0.44, 0.33), asked=([],), noise=0.0)
    found = Scorer(scene, HALVES, torch.device("cpu")).full(ball)
    plain = Scorer(scene, SMALL, torch.device("cpu")).full(Ball(albedo=ball.albedo))
    assert found.metrics == plain.metrics
    assert [quality.seed for quality in ball.asked[0]] == [0, 0, 0, 1, 1]  # the other half of one novel light says it for all
