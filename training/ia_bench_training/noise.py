"""Solid noise for textures, lights and displacement: pure functions of torch points, the same in every process."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

ALL, FIRST = slice(0, 4), slice(0, 1)  # channels of the noise
PERIOD = 32  # lattice cells after which the noise repeats; octaves are rotated, so that repetitions do not line up


@functools.cache
def lattice_values() -> Tensor:
    """Independent uniform values in [-1, 1] on a periodic lattice, (4, P + 1, P + 1, P + 1); the last layer repeats the first."""
    generator = torch.Generator().manual_seed(20_260_107)
    values = torch.rand(4, PERIOD, PERIOD, PERIOD, generator=generator) * 2 - 1
    for axis in (1, 2, 3):
        values = torch.cat([values, values.narrow(axis, 0, 1)], axis)
    return values


@functools.cache
def _octave_rotation() -> Tensor:
    """A rotation by about 40 degrees around a skew axis."""
    axis = torch.tensor([0.36, 0.48, 0.8])
    cross = torch.tensor([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return torch.matrix_exp(0.7 * cross)


def noise(points: Tensor, channels: slice = ALL) -> Tensor:
    """Value noise at points (N, 3), smooth between the corners of unit cells: (N, C) in [-1, 1], of C of four channels."""
    cell = torch.floor(points)
    inside = points - cell
    faded = cell + inside * inside * (3 - 2 * inside)
    wrapped = torch.remainder(faded, PERIOD) * (2 / PERIOD) - 1
    values = lattice_values()[None, channels]
    found = grid_sample(values, wrapped[None, :, None, None], align_corners=True, padding_mode="border")
    return found.reshape(values.shape[1], -1).T


def fractal(points: Tensor, octaves: int, gain: float = 0.5, *, channels: slice = ALL) -> Tensor:
    """Sum of ``octaves`` of :func:`noise`, each twice as fine and ``gain`` times as strong: (N, C), standard deviation 1.25.

    ``gain`` 0.5 falls like 1/f, as photographs do; more is rougher. Time goes with the number of ``channels``.
    """
    total, at = torch.zeros(()), points
    for octave in range(octaves):
        total = total + gain**octave * noise(at, channels)
        at = (at @ _octave_rotation()) * 2.03 + 7.3
    power = sum(gain ** (2 * octave) for octave in range(octaves))
    return total * (3.4 / math.sqrt(power))  # the standard deviation of one octave is 0.37


@functools.cache
def _neighbours() -> Tensor:
    line = torch.arange(-1, 2)
    return torch.cartesian_prod(line, line, line)


def hashed(cell: Tensor) -> Tensor:
    """Uniform values in [0, 1) of integer cells (..., 3): (..., 4), independent between neighbours."""
    x, y, z = torch.remainder(cell, PERIOD).unbind(-1)
    flat = lattice_values()[:, :PERIOD, :PERIOD, :PERIOD].reshape(4, -1).T
    return (flat[(x * PERIOD + y) * PERIOD + z] + 1) * 0.5


def cells(points: Tensor, jitter: float = 1.0) -> tuple[Tensor, Tensor, Tensor]:
    """Cellular noise (Worley 1996) at (N, 3): distances to the nearest two feature points (N,), values of the nearest (N, 4)."""
    base = torch.floor(points)
    around = base.long()[:, None] + _neighbours()
    feature = around + 0.5 + jitter * (hashed(around)[..., :3] - 0.5)
    distance = (feature - points[:, None]).square().sum(-1)
    nearest, which = distance.topk(2, dim=1, largest=False)
    cell = around.gather(1, which[:, :1, None].expand(-1, 1, 3))[:, 0]
    nearest = nearest.sqrt()
    return nearest[:, 0], nearest[:, 1], hashed(cell + 11)
