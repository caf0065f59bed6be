"""Half vectors between views and many directions of light, by their cosines alone."""

from __future__ import annotations

import torch
from torch import Tensor

GRAZING = 1e-8  # added to the square of a half vector's length, which is 0 where light comes from behind


def cosines(axis: Tensor, directions: Tensor) -> Tensor:
    """Between unit vectors of N points (N, 3) and the directions of each (N, D, 3): (N, D)."""
    return (directions @ axis[..., None])[..., 0]


def half_vector(normal: Tensor, view: Tensor, directions: Tensor, cos_i: Tensor) -> tuple[Tensor, Tensor]:
    """The cosines (n . h) and (o . h), in [0, 1], of half vectors between views o (N, 3) and directions (N, D, 3): (N, D) each.

    ``cos_i`` (N, D) is the cosine of the directions with the normal, which may be negative: were it cut at 0 here, (n . h) could be
    more than 1, and D has a pole there.
    """
    length = torch.sqrt((2 + 2 * cosines(view, directions)).clamp_min(0) + GRAZING)  # of o + w, twice (o . h)
    towards = cos_i + (normal * view).sum(1, keepdim=True)
    return (towards / length).clamp(0, 1), length / 2
