"""What makes a training run that was stopped end like one that was not: steps that depend on their number alone, and its state.

The state lies in the run's folder, and beside it one line for each validation. Every loop here has both, and goes on from the last
state whatever it had done since.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.paths import make_writable

FINAL_RATE = 0.02
"""Share of the full learning rate that is left at the last step."""
STATE, VALIDATIONS = "state.pt", "validation.jsonl"
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


def check_gradient(norm: Tensor, step: int) -> None:
    """Raise FloatingPointError unless the norm of the gradient of ``step`` is finite."""
    if not bool(torch.isfinite(norm)):
        raise FloatingPointError(f"step {step}: the gradient is NaN or Inf; the last checkpoint is kept")


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


def save_state(folder: Path, version: int, identity: str, state: Mapping[str, Any]) -> None:
    """Keep the ``state`` of the run with that ``identity``; ``version``: of what such a state holds."""
    with whole_file(folder / STATE) as partial:
        torch.save({"format": version, "identity": identity, **state}, partial)


def load_state(folder: Path, version: int, identity: str) -> dict[str, Any] | None:
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
    if found != version:
        raise InputError(f"{path}: expected format {version}, found {found}; choose another out=FOLDER")
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
