"""Several draws, fused views and their weights, against closed forms and against the truth of scene tiny."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.fusion import CELLS, fuse_views, view_scales
from ia_bench.methods.two_stage.losses import decode, encode
from ia_bench.methods.two_stage.settings import SupervisionSettings
from ia_bench.methods.two_stage.targets import Targets, average, distilled_targets, make_targets, to_one_scale
from ia_bench.priors.oracle import OraclePrior
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene

ALL = tuple(range(16))


class Both:
    """All that the targets read of a prior."""

    provides = frozenset({"albedo", "specular"})
    encoding: Mapping[str, str] = {"albedo": "srgb", "specular": "linear"}


def targets_of(problem: Problem, drawn: list[dict[str, Tensor]], asked: tuple[int, ...] = ALL, **settings: Any) -> Targets:
    free_scale = settings.pop("free_scale", True)
    changed = replace(problem, supervision=SupervisionSettings(**settings))
    return make_targets(changed, Both(), drawn, asked, free_scale=free_scale)  # type: ignore[arg-type]


def oracle_samples(scene: Scene, problem: Problem, count: int = 1, **dials: float) -> list[dict[str, Tensor]]:
    prior = OraclePrior(**dials)  # type: ignore[arg-type]
    prior.reveal(scene.train)
    images, masks = (torch.from_numpy(np.stack([getattr(v, name) for v in scene.train])) for name in ("image", "mask"))
    return [prior.sample(images, masks, seed=seed) for seed in range(count)]


# ---- several draws --------------------------------------------------------------------------------------------------


def test_one_draw_is_its_own_mean(problem: Problem, scene: Scene) -> None:
    samples = oracle_samples(scene, problem, noise=0.1)
    targets = targets_of(problem, samples)
    for name in ("albedo", "specular"):
        assert torch.equal(targets.values[name], problem.pixels_of(samples[0][name]))
        assert bool((targets.weights[name] == 1).all())
    assert not targets.common_scale


def test_mean_is_taken_where_errors_are_even() -> None:
    """Unbiased in the prior's encoding; a mean of the linear values would be 16 % too bright here."""
    generator = torch.Generator().manual_seed(0)
    truth, deviation, draws = 0.5, 0.15, 4000
    encoded = truth + deviation * torch.randn(draws, 1, 3, generator=generator)
    mean, spread = average(decode(encoded, "srgb"), "srgb")
    # The mean of 4000 draws is within 5 standard errors: a false alarm in a million runs.
    assert float((encode(mean, "srgb") - truth).abs().max()) < 5 * deviation / draws**0.5
    assert float(spread) == pytest.approx(deviation, rel=0.05)
    assert float(decode(encoded, "srgb").mean()) > 1.1 * float(decode(torch.tensor(truth), "srgb"))
    linear, spread = average(encoded, "linear")
    torch.testing.assert_close(linear, encoded.mean(0))
    torch.testing.assert_close(spread[:, 0], encoded.double().var(0).mean(-1).sqrt().float())


def test_encodings_are_inverse_to_each_other() -> None:
    values = torch.cat([torch.linspace(0, 0.01, 50), torch.linspace(0, 4, 200)])
    np.testing.assert_allclose(encode(values, "srgb"), linear_to_srgb(values.double().numpy()), atol=1e-6)
    for encoding in ("srgb", "linear"):
        torch.testing.assert_close(decode(encode(values, encoding), encoding), values, rtol=1e-5, atol=1e-7)


def test_scale_of_a_draw_is_no_disagreement(problem: Problem, scene: Scene) -> None:
    """Draws that differ by a scale per view alone: no spread left, and their common scale is the geometric mean."""
    exact = problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"])
    view = problem.gbuffer.pixel // (32 * 32)
    drawn = torch.stack([exact * s for s in (0.5, 0.25, 1.0)])
    even = to_one_scale(drawn, view, 16)
    torch.testing.assert_close(even, (exact * 0.5).expand_as(even), rtol=1e-4, atol=1e-6)
    assert float(average(even, "srgb")[1].max()) < 1e-4
    images = [problem.images_of(one) for one in drawn]
    free = targets_of(problem, [{"albedo": one, "specular": one} for one in images], samples=3)
    torch.testing.assert_close(free.values["albedo"], 0.5 * exact, rtol=1e-3, atol=1e-5)


def test_mean_of_draws_is_nearer_to_the_truth(problem: Problem, scene: Scene) -> None:
    truth = linear_to_srgb(problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"]).numpy())

    def error(count: int) -> float:
        targets = targets_of(problem, oracle_samples(scene, problem, count, noise=0.3), samples=count)
        return float(np.sqrt(((linear_to_srgb(targets.values["albedo"].numpy()) - truth) ** 2).mean()))

    assert error(8) < 0.6 * error(1)


def test_disagreement_lowers_the_weight(problem: Problem, scene: Scene) -> None:
    """A pixel that the draws disagree on by the spread's scale weighs half of one that they agree on."""
    exact = oracle_samples(scene, problem)[0]
    inner = torch.nonzero(problem.pixels_of(exact["albedo"]).amin(-1) > 0.1)[:, 0]
    odd = inner[::7]
    samples = []
    for sign in (-1, 1):
        pixels = encode(problem.pixels_of(exact["albedo"]), "srgb")
        pixels[odd] += sign * 0.1 / np.sqrt(2)  # two values a, b have the standard deviation |a - b| / sqrt(2)
        samples.append({**exact, "albedo": problem.images_of(decode(pixels, "srgb"))})
    targets = targets_of(problem, samples, samples=2, confidence="spread", spread_scale=0.1, free_scale=False)
    weight = targets.weights["albedo"][:, 0]
    agreed = torch.ones_like(weight, dtype=torch.bool).index_fill(0, odd, False)
    assert float(weight.mean()) == pytest.approx(1, rel=1e-5)
    torch.testing.assert_close(weight[odd], 0.5 * weight[agreed].mean().expand(len(odd)), rtol=1e-3, atol=0)
    assert float(weight[agreed].max() / weight[agreed].min()) == pytest.approx(1, rel=1e-4)
    assert bool((targets.weights["specular"] == 1).all())
    without = targets_of(problem, samples, samples=2, free_scale=False)
    assert bool((without.weights["albedo"] == 1).all())


def test_few_views_keep_the_loss_at_its_weight(problem: Problem, scene: Scene) -> None:
    exact = oracle_samples(scene, problem)[0]
    views = (1, 6, 9)
    targets = targets_of(problem, [{name: value[list(views)] for name, value in exact.items()}], views, views=3)
    asked = torch.isin(problem.gbuffer.pixel // (32 * 32), torch.tensor(views))
    for name, weight in targets.weights.items():
        assert float(weight.mean()) == pytest.approx(1, rel=1e-5)
        assert bool(((weight[:, 0] > 0) == asked).all())
        assert torch.equal(targets.values[name][asked], problem.pixels_of(exact[name])[asked])
        assert bool((targets.values[name][~asked] == 0).all())


def test_distilled_targets_cover_their_views(problem: Problem) -> None:
    estimate = torch.rand(2, 32, 32, 3, generator=torch.Generator().manual_seed(0))
    targets = distilled_targets(problem, {"albedo": estimate}, (3, 8))
    view = problem.gbuffer.pixel // (32 * 32)
    weight = targets.weights["albedo"][:, 0]
    assert bool(((weight > 0) == ((view == 3) | (view == 8))).all())
    assert float(weight.mean()) == pytest.approx(1, rel=1e-5)
    whole = torch.zeros(16, 32, 32, 3)
    whole[[3, 8]] = estimate
    assert torch.equal(targets.values["albedo"], problem.pixels_of(whole))


# ---- fused views ----------------------------------------------------------------------------------------------------


def test_scales_of_views_are_found_despite_outliers() -> None:
    """A synthetic two-way table: 12 views, each sees a tenth of 400 cells; a tenth of all values is nonsense."""
    random = np.random.default_rng(0)
    scale = random.normal(0, 0.4, 12)
    scale -= scale.mean()
    value = random.normal(-1, 0.7, 400)
    view, cell = random.integers(0, 12, 6000), random.integers(0, 400, 6000)
    log = value[cell] - scale[view] + 0.02 * random.standard_normal(6000)
    log[::10] += random.normal(1.0, 1.0, 600)
    found = view_scales(
        torch.from_numpy(log).float(), torch.ones(6000), torch.from_numpy(cell), torch.from_numpy(view), 12
    )
    # Nonsense of mean 1 in a tenth of the values would shift plain least squares of a view by about 0.05.
    np.testing.assert_allclose(found.numpy(), scale, atol=0.03)


def test_scales_of_views_that_share_nothing_stay() -> None:
    cell, view = torch.tensor([0, 1, 5, 5]), torch.tensor([0, 1, 2, 3])
    found = view_scales(torch.tensor([0.3, -2.0, 0.5, -0.5]), torch.ones(4), cell, view, 5)
    torch.testing.assert_close(found, torch.tensor([0.0, 0.0, -0.5, 0.5, 0.0]), rtol=1e-5, atol=1e-6)
    assert int(cell.max()) < CELLS**2


def fine(problem: Problem) -> Problem:
    """With textures as fine as the plan would choose, not as coarse as suits a quick fit."""
    return replace(problem, plan=replace(problem.plan, texture=128))


def srgb_error(problem: Problem, values: Tensor, truth: Tensor) -> float:
    """RMS of sRGB albedo over fully covered pixels, after one scale for the whole object."""
    inner = (problem.gbuffer.face >= 0).all(1)
    found, true = values[inner].double().numpy(), truth[inner].double().numpy()
    found = found * (true.mean() / found.mean())
    return float(np.sqrt(((linear_to_srgb(found.clip(0, 1)) - linear_to_srgb(true)) ** 2).mean()))


@pytest.mark.parametrize(
    ("dials", "share"),
    [({"scale": 0.3}, 0.45), ({"noise": 0.3}, 0.6), ({"inconsistency": 0.3}, 0.65), ({"scale": 0.3, "inconsistency": 0.3}, 0.6)],
    ids=str,
)
def test_fused_views_are_nearer_to_the_truth_than_single_ones(
    problem: Problem, scene: Scene, dials: dict[str, float], share: float
) -> None:
    """Under one scale for the object. What remains without noise is texture detail between texels and pixels."""
    problem = fine(problem)
    truth = problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"])
    samples = oracle_samples(scene, problem, **dials)
    single, fused = (targets_of(problem, samples, fuse=fuse).values["albedo"] for fuse in (False, True))
    assert targets_of(problem, samples, fuse=True).common_scale
    assert srgb_error(problem, fused, truth) < share * srgb_error(problem, single, truth)


def test_fusion_keeps_what_the_views_agree_on(problem: Problem, scene: Scene) -> None:
    problem = fine(problem)
    sample = oracle_samples(scene, problem)
    targets = targets_of(problem, sample, fuse=True)
    truth = problem.pixels_of(sample[0]["albedo"])
    assert srgb_error(problem, targets.values["albedo"], truth) < 0.025  # rms of fine texture, on a range of 1
    assert torch.equal(targets.values["specular"], problem.pixels_of(sample[0]["specular"]))  # it depends on the view
    coverage = (problem.gbuffer.face >= 0).float().mean(1, keepdim=True)
    assert bool((targets.values["albedo"] <= coverage + 1e-6).all())


def test_a_prior_of_known_scale_is_fused_as_it_is(problem: Problem, scene: Scene) -> None:
    truth = problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"])
    view = problem.gbuffer.pixel // (32 * 32)
    uneven = truth * (0.6 + 0.025 * view)[:, None]
    ones = torch.ones(len(truth), 1)
    aligned, _, _ = fuse_views(problem, uneven, ones, "srgb", align=True)
    trusted, _, _ = fuse_views(problem, uneven, ones, "srgb", align=False)
    assert srgb_error(problem, aligned, truth) < srgb_error(problem, trusted, truth)


def test_fusion_of_nothing_is_nothing(problem: Problem) -> None:
    """As of a wire that fills no pixel."""
    nothing = torch.zeros(len(problem.gbuffer.pixel), 1)
    _, spread, seen = fuse_views(problem, torch.rand(len(nothing), 3), nothing, "srgb", align=True)
    assert bool((spread == 0).all())
    assert bool((seen == 0).all())


def test_fused_few_views_supervise_what_they_saw(problem: Problem, scene: Scene) -> None:
    views = (0, 7)
    sample = {name: value[list(views)] for name, value in oracle_samples(scene, problem)[0].items()}
    targets = targets_of(problem, [sample], views, fuse=True, views=2)
    view = problem.gbuffer.pixel // (32 * 32)
    weight = targets.weights["albedo"][:, 0]
    others = weight[(view != 0) & (view != 7)]
    assert 0.1 < float((others > 0).float().mean()) < 1  # seen from elsewhere too, but not all around
    assert float(weight.mean()) == pytest.approx(1, rel=1e-5)
    truth = problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"])
    seen = (weight > 0) & (problem.gbuffer.face >= 0).all(1)
    assert float((targets.values["albedo"] - truth)[seen].abs().median()) < 0.03


def test_views_that_disagree_weigh_less(problem: Problem, scene: Scene) -> None:
    """One half of the texture is repainted in every other view: there the spread is high and the weight low."""
    truth = problem.pixels_of(oracle_samples(scene, problem)[0]["albedo"])
    gbuffer = problem.gbuffer
    hit = (gbuffer.face >= 0).int().argmax(1)
    rows = torch.arange(len(hit))
    uv = problem.renderer.surface.uv(gbuffer.face[rows, hit].long(), gbuffer.barycentric[rows, hit])
    view = gbuffer.pixel // (32 * 32)
    left = uv[:, 0] < 0.5
    painted = torch.where((left & (view % 2 == 0))[:, None], 0.3 * truth, truth)
    sample = {"albedo": problem.images_of(painted), "specular": problem.images_of(painted)}
    targets = targets_of(problem, [sample], fuse=True, confidence="spread", spread_scale=0.1, free_scale=False)
    weight = targets.weights["albedo"][:, 0]
    assert float(weight[left].median()) < 0.6 * float(weight[~left].median())


def test_pixels_near_the_ceiling_are_marked(problem: Problem, scene: Scene) -> None:
    """Of the views asked only, each by its own ceiling; without one nothing is marked."""
    asked = (2, 5)
    shape = (2, *problem.gbuffer.shape[1:], 3)
    specular = torch.full(shape, 0.5)
    specular[0, ::2] = 0.9
    drawn = [{"albedo": torch.full(shape, 0.5), "specular": specular}]
    targets = make_targets(
        problem, Both(), drawn, asked, free_scale=True, ceilings={"specular": torch.tensor([1.0, 0.6])}  # type: ignore[arg-type]
    )
    height, width = shape[1:3]
    view, row = problem.gbuffer.pixel // (height * width), problem.gbuffer.pixel // width % height
    expected = (view == 5) | ((view == 2) & (row % 2 == 0))
    assert torch.equal(targets.at_least["specular"][:, 0], expected)
    assert "albedo" not in targets.at_least
    assert not targets_of(problem, drawn, asked).at_least
