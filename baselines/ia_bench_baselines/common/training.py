"""The loop that trains the networks of a prior: checkpoints, validation, the best weights; draws from (seed, step) alone."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
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
from ia_bench_baselines.common.pictures import save_weights
from ia_bench_training.resuming import forget_validations_after, load_state, save_state, write_validation

WEIGHTS = "weights.safetensors"
STATE_FORMAT = 1  # of what a state holds: one of another format is refused
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
        return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


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
        """Do optimiser step ``number``, all of whose draws are ``generator``'s, and return its losses."""
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


def run(trainee: Trainee, settings: RunSettings, about: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Train to ``settings.steps`` or until the minutes are over, from the checkpoint if there is one; returns the best figures.

    ``about`` goes into the metadata of the weights. Raises InputError for a state that cannot be read or belongs to other settings,
    and where a loss is no number.
    """
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    step, seconds, best = _resume(trainee, settings)
    started = saved = time.monotonic()
    task = progress.task("training steps", settings.steps, done=step)
    losses: dict[str, list[float]] = {}
    while step < settings.steps:
        generator = torch.Generator().manual_seed(derive_seed(settings.seed, _STEP, step))
        for name, value in trainee.step(step, generator).items():
            if not math.isfinite(value):
                raise InputError(f"{settings.out}: step {step}: expected a finite loss {name}, found {value}")
            losses.setdefault(name, []).append(value)
        step += 1
        task.advance(1)
        now = time.monotonic()
        spent = seconds + now - started
        stop = settings.minutes is not None and now - started > 60 * settings.minutes
        if step % settings.validate_steps == 0 or step == settings.steps:
            trainee.networks.eval()
            with torch.no_grad():
                figures = trainee.validate()
            trainee.networks.train()
            means = {name: sum(values) / len(values) for name, values in losses.items()}
            losses = {}
            write_validation(settings.out, step, spent, {**figures, "training": means})
            if figures.get("objective", math.inf) < best.get("objective", math.inf):
                best = {"step": step, "seconds": round(spent, 1), **figures}
                save_weights(trainee.packaged(), settings.out / WEIGHTS, {**about, **best})
        if stop or step == settings.steps or now - saved > 60 * settings.checkpoint_minutes:
            _save(trainee, settings, step, spent, best)
            saved = now
        if stop:
            break
    return best


def _save(trainee: Trainee, settings: RunSettings, step: int, seconds: float, best: dict[str, Any]) -> None:
    state = {
        "step": step,
        "seconds": seconds,
        "best": best,
        "networks": trainee.networks.state_dict(),
        "optimisers": {name: optimiser.state_dict() for name, optimiser in trainee.optimisers.items()},
    }
    save_state(settings.out, STATE_FORMAT, settings.identity(), state)


def _resume(trainee: Trainee, settings: RunSettings) -> tuple[int, float, dict[str, Any]]:
    """Steps, seconds and best figures so far; what had been validated since is forgotten."""
    state = load_state(settings.out, STATE_FORMAT, settings.identity())
    forget_validations_after(0 if state is None else state["step"], settings.out)
    if state is None:
        return 0, 0.0, {}
    trainee.networks.load_state_dict(state["networks"])
    for name, optimiser in trainee.optimisers.items():
        optimiser.load_state_dict(state["optimisers"][name])
    return state["step"], state["seconds"], state["best"]


SettingsOf = TypeVar("SettingsOf", bound=RunSettings)


def training_command(settings: type[SettingsOf], usage: str, train: Callable[[SettingsOf, Progress], dict[str, Any]]) -> int:
    """Train as the process's arguments say, or print ``usage`` and every setting; returns the exit status.

    ``train`` returns the best validation figures.
    """

    def work(arguments: Sequence[str]) -> int:
        with Progress() as progress:
            chosen = read_arguments(settings, arguments)
            progress.note(f"best: {train(chosen, progress)}; {chosen.out / WEIGHTS}")
        return OK

    return command(lambda: usage + settings_text(settings), work, None)


def masked_mean(values: Tensor, masks: Tensor) -> Tensor:
    """Mean over the foreground of ``values`` (N, C, H, W), weighted by ``masks`` (N, 1, H, W)."""
    return (values * masks).sum() / (masks.sum() * values.shape[1]).clamp_min(1)
