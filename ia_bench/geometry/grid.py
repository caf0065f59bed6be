"""Signed distances on a regular grid: below zero inside the object, in scene units."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate


@dataclass(frozen=True)
class DistanceGrid:
    """Distances at the vertices of a box of cubic cells.

    ``values`` (X, Y, Z) float32, at the positions ``low`` + ``step`` (i, j, k); ``low`` (3,) float32; ``step`` in scene units.
    """

    values: Tensor
    low: Tensor
    step: float

    @property
    def high(self) -> Tensor:
        """The corner of the box opposite to ``low``, (3,)."""
        return self.low + self.step * (torch.tensor(self.values.shape) - 1)

    def positions(self) -> Tensor:
        """Where the vertices are, (X, Y, Z, 3)."""
        axes = (torch.arange(count, dtype=torch.float32) for count in self.values.shape)
        return self.low + self.step * torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)

    def at(self, points: Tensor) -> Tensor:
        """Trilinear distances (N,) at (N, 3) points; outside of the box that of its nearest face."""
        return sampled(self.values[None], self.low, self.high, points)[:, 0]

    def refined(self) -> DistanceGrid:
        """The same distances on a grid of the same box with cells of half the size, interpolated."""
        size = tuple(2 * count - 1 for count in self.values.shape)
        values = interpolate(self.values[None, None], size, mode="trilinear", align_corners=True)[0, 0]
        return DistanceGrid(values, self.low, 0.5 * self.step)

    def gradients(self) -> Tensor:
        """Central differences at the vertices, (3, X, Y, Z): the outward normal where the values are distances."""
        return torch.stack(torch.gradient(self.values, spacing=self.step))


def sampled(volume: Tensor, low: Tensor, high: Tensor, points: Tensor) -> Tensor:
    """Trilinear values (N, C) of a volume (C, X, Y, Z) over the box from ``low`` to ``high`` at (N, 3) points; differentiable."""
    place = 2 * (points - low) / (high - low) - 1
    grid = place.flip(-1)[None, None, None]
    return grid_sample(volume[None], grid, mode="bilinear", padding_mode="border", align_corners=True)[0, :, 0, 0].T
