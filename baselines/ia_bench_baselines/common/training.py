"""The loop that trains the networks of a prior: checkpoints, validation, the best weights; draws from (seed, step) alone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from ia_bench.common.arguments import read_arguments, settings_text
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, NotNegative, Number
from ia_bench.common.seeds import derive_seed
from ia_bench.methods.descent import check_finite, check_gradients
from ia_bench_baselines.common.pictures import save_weights
from ia_bench_training import resuming

WEIGHTS = "weights.safetensors"
_INITIAL, _STEP = 1, 2  # purposes of random streams


@dataclass(frozen=True)
class RunSettings:
    """What every training run has, besides the settings of its method.

    Attributes:
        data: Folder of training images.
        out: The run's folder: state.pt (it resumes from there), validation.jsonl, and weights.safetensors, the best so far.
        steps: Optimiser steps in all; a finished run may be told to go on with more.
        minutes: After so many the run stops and keeps its state; None for no limit.
        validate_steps: Steps between two validations.
        checkpoint_minutes: How often the state is kept.
        threads: Of the CPU; None for torch's own choice.
        device: "cpu" or "cuda".
        seed: Of every draw.
    """

    data: Path
    out: Path
    steps: Number = 10_000
    minutes: NotNegative | None = None
    validate_steps: Number = 250
    checkpoint_minutes: NotNegative = 3.0
    threads: Number | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    seed: Count = 0

    def identity(self) -> str:
        """Hash of what the weights depend on; a run resumes only where it is the same."""
        free = ("out", "steps", "minutes", "threads", "device", "checkpoint_minutes")
        values = {key: value for key, value in dataclasses.asdict(self).items() if key not in free}
        return resuming.identity(values)


class Trainee(Protocol):
    """What is trained: everything that changes lies in ``networks`` and ``optimisers``."""

    @property
    def networks(self) -> nn.Module:
        """All networks in one module."""
        ...

    @property
    def optimisers(self) -> Mapping[str, Optimizer]:
        """The optimisers by name."""
        ...

    def step(self, number: int, generator: torch.Generator) -> dict[str, float]:
        """Do optimiser step ``number``, all of whose draws are ``generator``'s, and return its losses.

        Raises FloatingPointError where one of them or a gradient is NaN or Inf, see :func:`descend`.
        """
        ...

    def validate(self) -> dict[str, float]:
        """Figures on held-out images; "objective" is the one by which weights are kept, lower is better.

        It is left out as long as nothing may be kept.
        """
        ...

    def packaged(self) -> nn.Module:
        """The part of the networks that the prior needs."""
        ...


def initial_weights(seed: int) -> torch.Generator:
    """Make torch draw a run's first weights from its seed. Networks draw them from the global generator."""
    return torch.manual_seed(derive_seed(seed, _INITIAL))


def descend(loss: Tensor, *optimisers: Optimizer) -> None:
    """Take a step down ``loss``. Raises FloatingPointError, before anything has changed, where it or a gradient is not finite."""
    parameters = [weight for optimiser in optimisers for group in optimiser.param_groups for weight in group["params"]]
    for weight in parameters:
        weight.grad = None
    check_finite("{} is NaN or Inf", {"the loss": loss.detach()})
    loss.backward()
    check_gradients({f"weight {number}": weight.grad for number, weight in enumerate(parameters)})
    for optimiser in optimisers:
        optimiser.step()


def run(trainee: Trainee, settings: RunSettings, about: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Train to ``settings.steps`` or until the minutes are over, from the checkpoint if there is one; returns the best figures.

    ``about`` goes into the metadata of the weights. Raises InputError for a state that cannot be read, or that was made with
    other settings or of other data, as far as ``about`` tells them.
    """
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    run_of = _Run(trainee, settings, about)
    resuming.run(
        run_of,
        settings.out,
        steps=settings.steps,
        identity=settings.identity(),
        progress=progress,
        validate_steps=settings.validate_steps,
        checkpoint_minutes=settings.checkpoint_minutes,
        minutes=settings.minutes,
    )
    return run_of.best


class _Run:
    """A trainee that keeps the weights of its best validation; see :class:`ia_bench_training.resuming.Trainee`."""

    def __init__(self, trainee: Trainee, settings: RunSettings, about: Mapping[str, Any]) -> None:
        self._trainee, self._settings, self._about = trainee, settings, about
        self._losses: dict[str, list[float]] = {}
        self.best: dict[str, Any] = {}

    def step(self, number: int) -> float:
        generator = torch.Generator().manual_seed(derive_seed(self._settings.seed, _STEP, number))
        losses = self._trainee.step(number, generator)
        for name, value in losses.items():
            self._losses.setdefault(name, []).append(value)
        return sum(losses.values())

    def validate(self, done: int, seconds: float) -> None:
        networks = self._trainee.networks.eval()
        with torch.no_grad():
            figures = self._trainee.validate()
        networks.train()
        means = {name: sum(values) / len(values) for name, values in self._losses.items()}
        self._losses = {}
        resuming.write_validation(self._settings.out, done, seconds, {**figures, "training": means})
        if figures.get("objective", math.inf) < self.best.get("objective", math.inf):
            self.best = {"step": done, "seconds": round(seconds, 1), **figures}
            save_weights(self._trainee.packaged(), self._settings.out / WEIGHTS, {**self._about, **self.best})

    def save(self, done: int, seconds: float) -> None:
        """Nothing beside the state: the weights are those of the best validation."""

    def state_dict(self) -> dict[str, Any]:
        optimisers = {name: optimiser.state_dict() for name, optimiser in self._trainee.optimisers.items()}
        return {
            "about": dict(self._about),
            "best": self.best,
            "losses": self._losses,
            "networks": self._trainee.networks.state_dict(),
            "optimisers": optimisers,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        about = state.get("about", self._about)
        if about != self._about:
            began = f"expected the data that {self._settings.out} began with ({about})"
            raise InputError(f"{self._settings.data}: {began}, found {self._about}; choose another out=FOLDER")
        self.best, self._losses = state["best"], state["losses"]
        self._trainee.networks.load_state_dict(state["networks"])
        for name, optimiser in self._trainee.optimisers.items():
            optimiser.load_state_dict(state["optimisers"][name])


SettingsOf = TypeVar("SettingsOf", bound=RunSettings)


def training_command(settings: type[SettingsOf], usage: str, train: Callable[[SettingsOf, Progress], dict[str, Any]]) -> int:
    """Train as the process's arguments say, or print ``usage`` and every setting; returns the exit status.

    ``train`` returns the best validation figures, none where no weights were worth keeping.
    """

    def work(arguments: Sequence[str]) -> int:
        with Progress() as progress:
            chosen = read_arguments(settings, arguments)
            best = train(chosen, progress)
            none = f"{chosen.out}: no weights yet, as no validation so far was worth keeping any; more steps go on"
            progress.note(f"best: {best}; {chosen.out / WEIGHTS}" if best else none)
        return OK

    return command(lambda: usage + settings_text(settings), work, None, resumes=True)


def masked_mean(values: Tensor, masks: Tensor) -> Tensor:
    """Mean over the foreground of ``values`` (N, C, H, W), weighted by ``masks`` (N, 1, H, W)."""
    return (values * masks).sum() / (masks.sum() * values.shape[1]).clamp_min(1)
