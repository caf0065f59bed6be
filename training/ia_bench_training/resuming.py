"""What makes a training run that was stopped end like one that was not: steps that depend on their number alone, and its state.

The state lies in the run's folder, and beside it one line for each validation. Every training run is the loop of
:mod:`ia_bench.methods.descent` with both, and goes on from the last state whatever it had done since.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.methods.descent import Descent, Phase, Stateful
from ia_bench.methods.monitor import Monitor

FINAL_RATE = 0.02
"""Share of the full learning rate that is left at the last step."""
STATE, VALIDATIONS = "state.pt", "validation.jsonl"
STATE_FORMAT = 5
"""Raised when a change of the code changes what a state holds."""
PERMUTATIONS = 1 << 20
"""Marks the random streams of permutations; those of batches are marked by their process."""


def rate_factor(step: int, steps: int, warmup: int) -> float:
    """Share of the full learning rate at ``step``: a linear rise, then a cosine down to FINAL_RATE."""
    rise = min(1.0, (step + 1) / max(warmup, 1))
    fall = FINAL_RATE + (1 - FINAL_RATE) * 0.5 * (1 + math.cos(math.pi * step / max(steps, 1)))
    return rise * fall


def batch_index(images: int, batch: int, seed: int, step: int) -> Tensor:
    """Images (batch,) of a step: successive parts of a permutation that is new in every pass over the data."""
    position = torch.arange(step * batch, (step + 1) * batch)
    parts = []
    for epoch in position.div(images, rounding_mode="floor").unique().tolist():
        order = torch.randperm(images, generator=torch.Generator().manual_seed(stream(seed, epoch, PERMUTATIONS)))
        parts.append(order[position[position // images == epoch] % images])
    return torch.cat(parts)


def stream(*path: int) -> int:
    """Make one seed of several numbers."""
    return int(np.random.SeedSequence(path).generate_state(1, np.uint64)[0] >> np.uint64(1))


def check_gradient(norm: Tensor, network: nn.Module) -> None:
    """Raise FloatingPointError, and forget the gradients, unless their ``norm`` is finite: such a step is left out."""
    if not bool(torch.isfinite(norm)):
        network.zero_grad(set_to_none=True)
        raise FloatingPointError("the gradient is NaN or Inf")


class Seeded(Protocol):
    """A folder of training data, and the seeds from which it was drawn."""

    folder: Path
    seeds: frozenset[int]


def check_seeds(what: str, data: Seeded, held_out: Seeded) -> None:
    """Raise InputError if ``what`` is held out has a seed in common with the data to train on."""
    shared = data.seeds & held_out.seeds
    if shared:
        raise InputError(f"{held_out.folder}: expected {what} of other seeds than in {data.folder}, found seed {min(shared)}")


def identity(values: Mapping[str, Any]) -> str:
    """Hash of the settings ``values``; a folder is the same however its path is written."""
    written = json.dumps(values, sort_keys=True, default=lambda value: str(value.resolve() if isinstance(value, Path) else value))
    return hashlib.sha256(written.encode()).hexdigest()[:16]


class Trainee(Stateful, Protocol):
    """What is trained. Its ``state_dict`` is everything that changes."""

    def step(self, number: int) -> float:
        """Take optimiser step ``number``, whose draws depend on that number alone, and return its loss.

        Raises FloatingPointError, before anything has changed, for a loss or gradient that is NaN or Inf.
        """
        ...

    def validate(self, done: int, seconds: float) -> None:
        """Look at held-out data after ``done`` steps, which took so many seconds."""
        ...

    def save(self, done: int, seconds: float) -> None:
        """Write the weights; called whenever the state has been kept."""
        ...


class _Ended(Exception):
    """The minutes of a run are over."""


def run(
    trainee: Trainee,
    folder: Path,
    *,
    steps: int,
    identity: str,
    progress: Progress,
    validate_steps: int,
    checkpoint_minutes: float = math.inf,
    minutes: float | None = None,
    writes: bool = True,
    agree: Callable[[bool], bool] = bool,
) -> None:
    """Train to ``steps`` or until the ``minutes`` are over, from the state in ``folder`` if there is one.

    It is validated every ``validate_steps`` and at the end. The state is kept after every validation, and every
    ``checkpoint_minutes``. A finished run may be told to go on with more steps, where its identity leaves them out.

    Args:
        trainee: What is trained.
        folder: The run's folder.
        steps: Steps in all.
        identity: What a state must have been saved with to be gone on from.
        progress: Where it is shown.
        validate_steps: Steps between two validations.
        checkpoint_minutes: Minutes between two states.
        minutes: After so many the run stops; None for no limit.
        writes: Whether this process is the one of several that writes.
        agree: Makes one answer of those of several processes, whose clocks differ.

    Raises InputError as :func:`load_state`, and FloatingPointError where ten steps in a row, or all of them, are NaN or Inf.
    """
    started, over, validated = time.monotonic(), False, False

    def after(done: int) -> None:
        nonlocal over, validated
        over = agree(minutes is not None and time.monotonic() - started > 60 * minutes)
        validated = done % validate_steps == 0 or done == steps or over
        if validated:
            with descent.book("validation"):
                trainee.validate(done, descent.seconds["training"])

    def save(state: dict[str, Any]) -> None:
        if writes:
            save_state(folder, identity, state)
            trainee.save(state["step"], descent.seconds["training"])
        if over:
            raise _Ended

    def load() -> dict[str, Any] | None:
        state = load_state(folder, identity)
        if writes:
            forget_validations_after(0 if state is None else state["step"], folder)
        return state

    monitor = Monitor(
        progress.task,
        progress.note,
        score=lambda *_: None,
        save=save,
        load=load,
        stopping=lambda: validated,
        checkpoint_seconds=60 * checkpoint_minutes,
    )
    phase = Phase("training", steps, step=lambda number, _: trainee.step(number), after=after)
    descent = Descent({}, [phase], seed=0, monitor=monitor, beside={"trainee": trainee})
    with suppress(_Ended):
        descent.descend()
    descent.check_progress()


def save_state(folder: Path, identity: str, state: Mapping[str, Any]) -> None:
    """Keep the ``state`` of the run with that ``identity``."""
    with whole_file(folder / STATE) as partial:
        torch.save({"format": STATE_FORMAT, "identity": identity, **state}, partial)


def load_state(folder: Path, identity: str) -> dict[str, Any] | None:
    """The state from which a run goes on in ``folder``, which is made where it is missing; None of a new run.

    Raises InputError for a folder that cannot be written, a damaged file, another version, and the state of a run with another
    identity.
    """
    path = folder / STATE
    make_writable(folder, "out")
    if not path.is_file():
        return None
    try:
        state: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever torch raises on a damaged file
        raise InputError(f"{path}: expected the state of a training run, found a file that cannot be read ({error})") from error
    found = state.get("format") if isinstance(state, dict) else None
    if found != STATE_FORMAT:
        raise InputError(f"{path}: expected format {STATE_FORMAT}, found {found}; choose another out=FOLDER")
    if state["identity"] != identity:
        raise InputError(f"{path}: belongs to a run with other settings; choose another out=FOLDER or the old settings")
    return dict(state)


def write_validation(folder: Path, step: int, seconds: float, figures: Mapping[str, Any]) -> None:
    """Add the ``figures`` of a validation after ``step``."""
    with (folder / VALIDATIONS).open("a") as file:
        file.write(json.dumps({"step": step, "seconds": round(seconds, 1), **figures}) + "\n")


def forget_validations_after(step: int, folder: Path) -> None:
    """Remove what a run that was stopped had validated beyond its last checkpoint; it is validated again."""
    path = folder / VALIDATIONS
    if not path.exists():
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]  # a kill may leave half a line
    with whole_file(path) as partial:
        partial.write_text("".join(kept), encoding="utf-8")
