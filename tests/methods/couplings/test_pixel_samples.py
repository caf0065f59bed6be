"""Targets and their weights, against the prior's own sample of scene tiny."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.methods.contract import PixelSamples, Problem
from ia_bench.methods.couplings.sampler import pixel_samples
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.oracle import OraclePrior
from ia_bench.runs.scene import ToldPrior
from ia_bench.scenes.scene import Scene

ALL = tuple(range(16))


def targets_of(problem: Problem, sample: Mapping[str, Tensor], asked: tuple[int, ...] = ALL) -> PixelSamples:
    return pixel_samples(problem, Samples(sample), asked)


def oracle_sample(scene: Scene, **dials: float) -> Mapping[str, Tensor]:
    prior = ToldPrior(OraclePrior(**dials), lambda: scene.train)  # type: ignore[arg-type]
    images, masks = (torch.from_numpy(np.stack([getattr(v, name) for v in scene.train])) for name in ("image", "mask"))
    return prior.sample(Observations(images, masks, ALL), seed=0).values


def test_targets_are_the_sample(problem: Problem, scene: Scene) -> None:
    sample = oracle_sample(scene, noise=0.1)
    targets = targets_of(problem, sample)
    for name in ("albedo", "specular"):
        assert torch.equal(targets.values[name], problem.pixels_of(sample[name]))
    assert bool((targets.weight == 1).all())


def test_few_views_keep_the_loss_at_its_weight(problem: Problem, scene: Scene) -> None:
    exact = oracle_sample(scene)
    views = (1, 6, 9)
    targets = targets_of(problem, {name: value[list(views)] for name, value in exact.items()}, views)
    asked = torch.isin(problem.gbuffer.pixel // (32 * 32), torch.tensor(views))
    assert float(targets.weight.mean()) == pytest.approx(1, rel=1e-5)
    assert bool(((targets.weight[:, 0] > 0) == asked).all())
    for name in ("albedo", "specular"):
        assert torch.equal(targets.values[name][asked], problem.pixels_of(exact[name])[asked])
        assert bool((targets.values[name][~asked] == 0).all())


def test_distilled_targets_cover_their_views(problem: Problem) -> None:
    estimate = torch.rand(2, 32, 32, 3, generator=torch.Generator().manual_seed(0))
    targets = targets_of(problem, {"albedo": estimate}, (3, 8))
    view = problem.gbuffer.pixel // (32 * 32)
    weight = targets.weight[:, 0]
    assert bool(((weight > 0) == ((view == 3) | (view == 8))).all())
    assert float(weight.mean()) == pytest.approx(1, rel=1e-5)
    whole = torch.zeros(16, 32, 32, 3)
    whole[[3, 8]] = estimate
    assert torch.equal(targets.values["albedo"], problem.pixels_of(whole))


def test_pixels_near_the_ceiling_are_marked(problem: Problem, scene: Scene) -> None:
    """Of the views asked only, each by its own ceiling; without one nothing is marked."""
    asked = (2, 5)
    shape = (2, *problem.gbuffer.shape[1:], 3)
    specular = torch.full(shape, 0.5)
    specular[0, ::2] = 0.9
    drawn = {"albedo": torch.full(shape, 0.5), "specular": specular}
    targets = pixel_samples(problem, Samples(drawn, {"specular": torch.tensor([1.0, 0.6])}), asked)
    height, width = shape[1:3]
    view, row = problem.gbuffer.pixel // (height * width), problem.gbuffer.pixel // width % height
    expected = (view == 5) | ((view == 2) & (row % 2 == 0))
    assert torch.equal(targets.at_least["specular"][:, 0], expected)
    assert "albedo" not in targets.at_least
    assert not targets_of(problem, drawn, asked).at_least
