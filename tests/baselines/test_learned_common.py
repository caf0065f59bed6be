"""What the priors with small networks share: weights in files, runs that resume, and the generator's images under other lights."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn
from torch.optim import Adam

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.priors.weight_files import fill
from ia_bench_baselines.common.training import WEIGHTS, RunSettings, initial_weights, run, training_command
from ia_bench_training.resuming import VALIDATIONS


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
    with pytest.raises(InputError, match=r"expected the data that .*half began with \(\{\}\), found \{'objects': 9\}"):
        run(Line(3), settings(half, steps=70), {"objects": 9}, Progress())


class Unjudged(Line):
    """One whose weights are not worth keeping yet, as those of Yi et al. in their supervised steps."""

    def validate(self) -> dict[str, float]:
        return {"square": 0.0}


@pytest.mark.parametrize("kind", [Line, Unjudged])
def test_a_command_names_weights_that_are_there(
    kind: type[Line], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["train", f"data={tmp_path}", f"out={tmp_path}", "steps=2"])
    assert training_command(RunSettings, "", lambda chosen, progress: run(kind(3), chosen, {}, progress)) == 0
    assert (str(tmp_path / WEIGHTS) in capsys.readouterr().err) == (tmp_path / WEIGHTS).is_file() == (kind is Line)
