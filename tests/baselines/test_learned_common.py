"""What the priors with small networks share: weights in files, runs that resume, and the generator's images under other lights."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from torch import Tensor, nn
from torch.optim import Adam

from ia_bench.common.progress import Progress
from ia_bench.priors.weight_files import fill
from ia_bench_baselines.common.pictures import save_weights
from ia_bench_baselines.common.training import WEIGHTS, RunSettings, initial_weights, masked_mean, run
from ia_bench_training.generate import render_images, render_relit
from ia_bench_training.lights import draw_light
from ia_bench_training.objects import make_object
from ia_bench_training.render import draw_view
from ia_bench_training.resuming import VALIDATIONS
from ia_bench_training.shading import DirectLight


class Line:
    """A line that is fitted to noisy points: the smallest thing that can be trained."""

    def __init__(self, seed: int) -> None:
        initial_weights(seed)
        self.networks: nn.Module = nn.Linear(1, 1)
        self.optimisers = {"all": Adam(self.networks.parameters(), 0.1)}

    def packaged(self) -> nn.Module:
        return self.networks

    def step(self, number: int, generator: torch.Generator) -> dict[str, float]:
        x = torch.rand(8, 1, generator=generator)
        loss = (self.networks(x) - 3 * x + 1 + 0.1 * torch.randn(8, 1, generator=generator)).square().mean()
        self.optimisers["all"].zero_grad()
        loss.backward()
        self.optimisers["all"].step()
        return {"square": float(loss.detach())}

    def validate(self) -> dict[str, float]:
        x = torch.linspace(0, 1, 9)[:, None]
        return {"objective": float((self.networks(x) - 3 * x + 1).square().mean())}


def settings(folder: Path, **changes: object) -> RunSettings:
    return RunSettings(**{"data": folder, "out": folder, "steps": 60, "validate_steps": 7, **changes})  # type: ignore[arg-type]


def validations(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / VALIDATIONS).read_text().splitlines()]


def test_the_weights_that_are_kept_are_those_of_the_best_validation(tmp_path: Path):
    best = run(Line(0), settings(tmp_path), {"points": 8}, Progress())
    lines = validations(tmp_path)
    assert best["objective"] == min(line["objective"] for line in lines) < 0.1 * lines[0]["objective"]
    with safe_open(tmp_path / WEIGHTS, framework="pt") as file:
        about = json.loads(file.metadata()["about"])
    assert (about["points"], about["step"]) == (8, best["step"])


class Killed(Line):
    """One whose process ends at step 30."""

    def step(self, number: int, generator: torch.Generator) -> dict[str, float]:
        if number == 30:
            raise KeyboardInterrupt
        return super().step(number, generator)


def test_a_killed_run_validates_every_step_once_and_ends_with_the_very_same_weights(tmp_path: Path):
    """It is killed after 30 steps, when it has validated 28, and goes on from the 23 that an earlier end left."""
    whole, half = tmp_path / "whole", tmp_path / "half"
    best = run(Line(3), settings(whole), {}, Progress())
    run(Line(3), settings(half, steps=23), {}, Progress())
    with pytest.raises(KeyboardInterrupt):
        run(Killed(3), settings(half), {}, Progress())
    assert [line["step"] for line in validations(half)] == [7, 14, 21, 23, 28]
    again = run(Line(3), settings(half), {}, Progress())
    found, expected = ({line["step"]: line["objective"] for line in validations(folder)} for folder in (half, whole))
    assert [line["step"] for line in validations(half)] == [7, 14, 21, 23, 28, 35, 42, 49, 56, 60]
    assert {step: found[step] for step in expected} == expected
    assert (again["step"], again["objective"]) == (best["step"], best["objective"])
    straight, resumed = nn.Linear(1, 1), nn.Linear(1, 1)
    for network, folder in ((straight, whole), (resumed, half)):
        fill(network, folder / WEIGHTS)
    assert torch.equal(straight.weight, resumed.weight)


def test_weights_come_back_from_half_precision(tmp_path: Path):
    path, network, again = tmp_path / "a.safetensors", nn.Linear(3, 2), nn.Linear(3, 2)
    save_weights(network, path, {})
    fill(again, path)
    torch.testing.assert_close(again.weight, network.weight, rtol=2**-11, atol=1e-7)


def test_a_masked_mean_is_that_of_the_foreground():
    values, mask = torch.rand(2, 3, 5, 7), torch.zeros(2, 1, 5, 7)
    mask[0, :, 1:3, 2:6] = 1
    torch.testing.assert_close(masked_mean(values, mask), values[0, :, 1:3, 2:6].mean())
    assert float(masked_mean(values, 0 * mask)) == 0


def light_of(seed: int, index: int, size: int) -> object:
    """The light of an image whose first draw is taken."""
    group, view = divmod(index, 8)
    solid = make_object(np.random.default_rng([seed, 1, group, 0]))
    return draw_view(np.random.default_rng([seed, 2, group, view, 0]), solid, size).light


@pytest.mark.parametrize("index", [8, 13])
def test_an_image_under_its_own_light_is_the_image_of_the_generator(index: int):
    """To the last bit, and another light changes the radiance, but neither mask, albedo nor normals."""
    direct, size = DirectLight(compiled=False), 16
    usual, rejected = render_images(3, index, 1, size, direct)
    assert rejected == 0
    own, other = light_of(3, index, size), draw_light(np.random.default_rng(0))
    relit = render_relit(3, index, [own], size, direct)  # type: ignore[list-item]
    for name, values in usual.items():
        assert torch.equal(values, relit[name]), name
    both = render_relit(3, index, [other, own], size, direct)  # type: ignore[list-item]
    assert same(both, ("albedo", "normal"), 0, 1)
    assert torch.equal(both["image"][0, ..., 3], both["image"][1, ..., 3])
    torch.testing.assert_close(both["image"][1], relit["image"][0])
    assert float((both["image"][0] - both["image"][1]).abs().max()) > 0.05


def same(images: dict[str, Tensor], names: tuple[str, ...], first: int, second: int) -> bool:
    return all(torch.equal(images[name][first], images[name][second]) for name in names)
