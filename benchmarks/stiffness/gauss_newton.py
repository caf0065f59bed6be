"""J and its transpose without ever forming J: one recorded evaluation of the residuals, played forward and backward.

Reverse mode gives v -> J^T v, which is linear in v; its own derivative is J. So both products come from one graph, in which
every random sample is fixed, whatever made the residuals. Only code that torch can differentiate twice will do, which the
renderer's kernels are not: benchmarks/reference.py renders instead. Products are in the precision of the recording, float32
for the renderer: what they add up to is float64.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from scipy.sparse.linalg import LinearOperator, eigsh
from torch import Tensor


class Jacobian:
    """J of ``residual`` (R...,) with respect to named leaf tensors, at the values that these had when it was recorded.

    Vectors of parameters are flat, the tensors one after the other in the order of the mapping: (n,); those of residuals
    have the shape of ``residual``.
    """

    def __init__(self, residual: Tensor, parameters: Mapping[str, Tensor]) -> None:
        """The parameters must have been leaves that require gradients when ``residual`` was computed from them."""
        self.parameters = dict(parameters)
        self._leaves = list(parameters.values())
        self._residual = residual
        self._cotangent = torch.zeros_like(residual, requires_grad=True)
        self._pulled = torch.autograd.grad(residual, self._leaves, self._cotangent, create_graph=True)
        self.rows, self.columns = residual.numel(), sum(leaf.numel() for leaf in self._leaves)
        ends = np.cumsum([leaf.numel() for leaf in self._leaves])
        starts = [0, *ends[:-1]]
        self.slices = {name: slice(int(a), int(b)) for name, a, b in zip(parameters, starts, ends, strict=True)}

    def forward(self, vector: Tensor) -> Tensor:
        """J times (n,): how the residuals change."""
        parts = [part.reshape(leaf.shape) for part, leaf in zip(self._split(vector), self._leaves, strict=True)]
        return torch.autograd.grad(self._pulled, self._cotangent, parts, retain_graph=True)[0]

    def backward(self, cotangent: Tensor) -> Tensor:
        """J^T times residuals: (n,)."""
        pulled = torch.autograd.grad(self._residual, self._leaves, cotangent, retain_graph=True)
        return torch.cat([part.reshape(-1) for part in pulled])

    def columns_seen(self) -> Tensor:
        """Which parameters any residual depends on, (n,) bool: J^T times noise is zero elsewhere, and almost surely only there."""
        noise = torch.randn(self._residual.shape, generator=torch.Generator().manual_seed(0)).to(self._residual)
        return self.backward(noise) != 0

    def gauss_newton(self) -> LinearOperator:
        """J^T J / R as scipy takes it, float64 outside, the recording's precision inside."""

        def product(vector: np.ndarray) -> np.ndarray:
            flat = torch.from_numpy(vector.reshape(-1)).to(self._residual)
            return self.backward(self.forward(flat)).double().numpy() / self.rows

        return LinearOperator((self.columns, self.columns), matvec=product, dtype=np.float64)

    def _split(self, vector: Tensor) -> tuple[Tensor, ...]:
        return vector.split([leaf.numel() for leaf in self._leaves])


def stiffest(jacobian: Jacobian, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` largest eigenvalues of J^T J / R, descending, and their unit vectors (n, count).

    By implicitly restarted Lanczos (ARPACK, which keeps its basis orthogonal). Its tolerance is that of float32 products.
    """
    start = np.random.default_rng(0).standard_normal(jacobian.columns)
    values, vectors = eigsh(jacobian.gauss_newton(), k=count, which="LA", v0=start, tol=1e-5)
    return values[::-1], vectors[:, ::-1]


def gram(jacobian: Jacobian, seen: np.ndarray) -> np.ndarray:
    """J^T J (not divided by R) of the parameters ``seen`` (n,) bool, as a dense float64 matrix.

    For parameters of shape (..., 3) of which channel c acts on channel c of the residuals (..., 3) alone, as it is with albedo
    and light in every renderer that treats the channels alike, one product gives three columns.
    """
    place = np.cumsum(seen) - 1
    matrix = np.zeros((int(seen.sum()), jacobian.rows), np.float32)  # J^T: a column of J at a time is a row here
    for name, leaf in jacobian.parameters.items():
        channels = leaf.shape[-1]
        if channels not in (1, 3):
            raise ValueError(f"{name}: expected 1 or 3 channels, found {channels}")
        first = jacobian.slices[name].start
        for texel in np.nonzero(seen[jacobian.slices[name]].reshape(-1, channels).any(1))[0].tolist():
            columns = first + channels * texel + torch.arange(channels)
            direction = torch.zeros(jacobian.columns, dtype=leaf.dtype)
            direction[columns] = 1
            change = jacobian.forward(direction).reshape(-1, 3)
            for channel, column in enumerate(columns.tolist()):
                if not seen[column]:
                    continue
                if channels == 1:
                    matrix[place[column]] = change.reshape(-1).numpy()
                else:
                    matrix[place[column], channel::3] = change[:, channel].numpy()
    exact = matrix.astype(np.float64)
    return exact @ exact.T
