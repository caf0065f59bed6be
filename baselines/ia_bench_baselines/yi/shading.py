"""Diffuse shading by nine spherical harmonics (Ramamoorthi and Hanrahan 2001), as a quadratic form of the normal."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

C1, C2, C3, C4, C5 = 0.429043, 0.511664, 0.743125, 0.886227, 0.247708
"""Their equation 13: clamped-cosine coefficients times normalisations of the harmonics."""
AMBIENT = 0.1  # added to what is not negative, so that the albedo, image / shading, stays bounded
STEEPEST = 3.0  # largest |p| and |q| of a normal (p, q, 1): 77 degrees from the camera


def irradiance(normals: Tensor, light: Tensor) -> Tensor:
    """Integral over directions w of L(w) max(n . w, 0), for L the sum of ``light`` (N, 9) times real spherical harmonics.

    ``normals`` (N, 3, H, W), unit: x right, y up, z toward the camera. The coefficients are in the order L00, L1-1, L10, L11, L2-2,
    L2-1, L20, L21, L22. Returns (N, 1, H, W).
    """
    x, y, z = normals.unbind(1)
    basis = torch.stack(
        [
            C4 * torch.ones_like(x),
            2 * C2 * y,
            2 * C2 * z,
            2 * C2 * x,
            2 * C1 * x * y,
            2 * C1 * y * z,
            C3 * z * z - C5,
            2 * C1 * x * z,
            C1 * (x * x - y * y),
        ],
        1,
    )
    return torch.einsum("nkhw,nk->nhw", basis, light)[:, None]


def shading(normals: Tensor, light: Tensor) -> Tensor:
    """Grey shading (N, 1, H, W), at least AMBIENT. ``light`` (N, 9) as a network has it: scaled to length one, |L00|."""
    unit = F.normalize(light, dim=1)
    ambient_first = torch.cat([unit[:, :1].abs(), unit[:, 1:]], 1)
    return irradiance(normals, ambient_first).clamp_min(0) + AMBIENT


def normals_of(slopes: Tensor) -> Tensor:
    """Unit normals (N, 3, H, W) along (p, q, 1), for slopes (N, 2, H, W) as a tanh has them, in [-1, 1]."""
    steep = STEEPEST * slopes
    return F.normalize(torch.cat([steep, torch.ones_like(steep[:, :1])], 1), dim=1)


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
