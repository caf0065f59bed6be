"""The low-rank loss: what one object shows under B lights must be one picture, times a number for each light."""

from __future__ import annotations

import torch
from torch import Tensor

SCALE = 100.0
DARKEST = 1e-5  # to which a diffuse picture is raised before its chromaticity is taken


def rank_one_distance(stack: Tensor) -> Tensor:
    """Frobenius distance of a matrix (M, B) to its nearest of rank one, sqrt(sum over i > 1 of sigma_i^2).

    The nearest matrix keeps the largest singular value alone. Because it is the nearest, the distance has the same gradient
    whether it is followed through the SVD or held fixed. Taken from singular values without their vectors, the gradient is
    finite also where two of them are equal.
    """
    values: Tensor = torch.linalg.svdvals(stack)
    return torch.linalg.vector_norm(values[1:])


def low_rank_loss(pictures: Tensor, mask: Tensor) -> Tensor:
    """100 d / |mask|, with d the distance from rank one of ``pictures`` (B, C, H, W), a column each, inside ``mask`` (1, H, W)."""
    return SCALE * rank_one_distance((pictures * mask).flatten(1).T) / mask.sum().clamp_min(1)


def chromaticity(diffuse: Tensor) -> Tensor:
    """Red and green (N, 2, H, W) of the sum of a diffuse picture's channels: under lights of one colour it is the paint's alone."""
    lit = diffuse.clamp(DARKEST, 1)
    return lit[:, :2] / lit.sum(1, keepdim=True)


def relative_distance(pictures: Tensor, mask: Tensor) -> Tensor:
    """The distance from rank one as a share of the pictures' own norm, which no common factor changes; for validation."""
    stack = (pictures * mask).flatten(1).T
    return rank_one_distance(stack) / torch.linalg.matrix_norm(stack).clamp_min(1e-9)
