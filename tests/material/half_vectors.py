"""Directions and half vectors at which the tests of the BRDF, in torch and in kernels, look."""

import math

import numpy as np
import torch
from torch import Tensor

from ia_bench.material.brdf import MIN_ROUGHNESS, dot, normalize

ROUGHNESS = (1e-4, 1e-3, 1e-2, MIN_ROUGHNESS, 0.1, 0.3, 0.6, 1.0)
RENDERED = [roughness for roughness in ROUGHNESS if roughness >= MIN_ROUGHNESS]
DEGREES = (5, 45, 80, 89, 89.9, 89.99)  # the last has a cosine of 1.7 MIN_COSINE
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
RINGS, SECTORS, NODES = 10, 16, 24  # cells of the chi-square grid, Gauss nodes along each side of a cell
DRAWS = 100_000


def view_at(degrees: float) -> Tensor:
    """A view direction at an angle from the normal +z, off the axes."""
    theta, phi = math.radians(degrees), 0.7
    return torch.tensor([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)], dtype=torch.float64)


def half_vector_grid(roughness: float) -> tuple[Tensor, Tensor]:
    """Half vectors (R, S, N, N, 3) of Gauss nodes in R rings of q and S sectors of a; their solid angles."""
    node, weight = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(NODES))
    node, weight = (node + 1) / 2, weight / 2
    q = (torch.arange(RINGS)[:, None] + node) * (math.pi / 2 / RINGS)
    a = (torch.arange(SECTORS)[:, None] + node) * (2 * math.pi / SECTORS)
    alpha = roughness**2
    slope = alpha * torch.tan(q)
    shape = (RINGS, SECTORS, NODES, NODES)
    across = slope[:, None, :, None].expand(shape)
    angle = a[None, :, None, :].expand(shape)
    half = normalize(torch.stack([across * angle.cos(), across * angle.sin(), torch.ones(shape)], -1).double())
    area = alpha**2 * torch.tan(q) / torch.cos(q) ** 2  # slope d slope = alpha^2 tan(q) / cos(q)^2 dq
    cell = (area * weight * (math.pi / 2 / RINGS))[:, None, :, None] * (weight * 2 * math.pi / SECTORS)[None, None, None, :]
    return half, half[..., 2] ** 3 * cell


def mirrored(half: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
    """Incident directions that h mirrors the view into, and d omega_i / d omega_h (zero where h faces away)."""
    cosine = dot(view.expand_as(half), half)
    return 2 * cosine * half - view, 4 * cosine[..., 0].clamp_min(0)


def cells_of(half: np.ndarray, roughness: float) -> np.ndarray:
    """Index of the grid's cell of each half vector."""
    q = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2] * roughness**2)
    ring = np.clip((q / (np.pi / 2) * RINGS).astype(int), 0, RINGS - 1)
    sector = (np.arctan2(half[:, 1], half[:, 0]) % (2 * np.pi) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    return ring * SECTORS + sector


def rough(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def random_pairs(count: int, seed: int, roughness: float) -> tuple[Tensor, Tensor]:
    """Random views above and incident directions anywhere, half of them inside the lobe; float64. Down to a cosine of 0.001."""
    rng = torch.Generator().manual_seed(seed)
    view = normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64))
    view[::3, 2] = torch.logspace(-3, -1, len(view[::3]), dtype=torch.float64)
    view[:, 2] = view[:, 2].abs().clamp_min(1e-3)
    view = normalize(view)
    anywhere = torch.randn(count, 3, generator=rng, dtype=torch.float64)
    lobe = roughness**2 * view[:, 2:] * torch.randn(count, 3, generator=rng, dtype=torch.float64)
    near = view * torch.tensor([-1.0, -1.0, 1.0]) + lobe
    incident = torch.where(torch.arange(count)[:, None] % 2 == 0, anywhere, near)
    return view, normalize(incident)
