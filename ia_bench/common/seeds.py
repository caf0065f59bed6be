"""Seeds for the parts and purposes of a run."""

from __future__ import annotations

import numpy as np


def derive_seed(seed: int, *path: int) -> int:
    """A seed for one part or purpose of what ``seed`` (>= 0) stands for, as independent of it as if it were random."""
    return int(np.random.SeedSequence(seed, spawn_key=path).generate_state(1, np.uint64)[0] >> np.uint64(1))
