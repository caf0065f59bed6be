"""Low-discrepancy samples: one rank-1 lattice for all points of a pixel, moved by a Cranley-Patterson rotation of its own.

The rotation adds one uniform vector to all entries, modulo 1 (Cranley and Patterson 1976): each entry alone is then uniform.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.material.brdf import GOLDEN

PLASTIC = 0.7548776662466927  # the third generator, from the plastic number (Roberts' R2 sequence); the second is GOLDEN


def lattice(rotation: Tensor, points: int, count: int, part: int = 0, parts: int = 1) -> Tensor:
    """Lattice samples of (P, 3) rotations in [0, 1), one a pixel: (P, points, count, 3), uniform in [0, 1)^3, float64.

    Point s of a pixel takes the lattice's entries s, s + points, s + 2 points, ..., so that each spans the whole range. A
    lattice too long for one pass is dealt out to ``parts`` of them: of each point's entries the first pass takes the first, the
    second the second, and so on in turn; ``part`` says which pass this is.
    """
    entry = part + parts * torch.arange(count, dtype=torch.float64, device=rotation.device)
    index = (points * entry[:, None] + torch.arange(points, device=rotation.device)).reshape(-1)
    generators = torch.stack([index / (parts * points * count), index * GOLDEN, index * PLASTIC], -1)
    samples = torch.remainder(rotation[:, None] + generators, 1.0).clamp(max=1 - 2**-24)
    return samples.reshape(len(rotation), count, points, 3).transpose(1, 2)
