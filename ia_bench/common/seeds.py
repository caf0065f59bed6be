"""Seeds for the parts and purposes of a run: everything random that is new asks :func:`derive_seed`.

What published numbers and the shipped weights were made with keeps its draws, seeded in another way: the steps of a fit (one
generator of the run's seed), the views that a distilling fit draws (seed, step), and the training of the priors (its data by
seed, purpose and number; its order and augmentation by ``ia_bench_training.resuming.stream``; the refiner's batches by a sum;
that of ``yi`` and ``usi3d`` by their own seeds).
"""

from __future__ import annotations

from zlib import crc32

import numpy as np


def derive_seed(seed: int, *purpose: int | str) -> int:
    """A seed for one part or purpose of what ``seed`` (>= 0) stands for, as independent of it as if it were random."""
    path = [crc32(part.encode()) if isinstance(part, str) else part for part in purpose]
    return int(np.random.SeedSequence(seed, spawn_key=path).generate_state(1, np.uint64)[0] >> np.uint64(1))
