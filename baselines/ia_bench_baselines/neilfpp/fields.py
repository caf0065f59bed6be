"""The three networks of NeILF++: material, incident light and the light that the surface sends out."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import embedding

from ia_bench_baselines.common.networks import encoded, initialise, perceptron, positional_encoding
from ia_bench_baselines.neilfpp.method import LEAST_ROUGHNESS, NeilfppOptions

FREQUENCIES = 4  # of the encodings of directions
LAST = 1e-2  # bound of the last layer's weights at the start, so that a field starts nearly constant
BRIGHTEST = 3.0  # radiance that the surface light field can reach
PRIMES = (1, 2_654_435_761, 805_459_861)


class HashGrid(nn.Module):
    """Features of positions in [-1, 1]^3 from grids of growing resolution, kept in tables (Müller et al. 2022, Instant NGP)."""

    resolution: Tensor
    corners: Tensor

    def __init__(
        self, *, coarsest: int, finest: int, generator: torch.Generator, levels: int = 8, features: int = 2, log_size: int = 14
    ) -> None:
        """``levels`` grids from ``coarsest`` to ``finest`` cells a side, each of 2^``log_size`` entries of so many features."""
        super().__init__()
        device = generator.device
        growth = (finest / coarsest) ** (torch.arange(levels, device=device) / max(levels - 1, 1))
        self.register_buffer("resolution", (coarsest * growth).round())
        self.register_buffer("corners", torch.tensor([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], device=device))
        self.size, self.outputs = 2**log_size, levels * features
        values = torch.rand(levels * self.size, features, generator=generator, device=device)
        self.table = nn.Parameter(1e-4 * (2 * values - 1))

    def forward(self, position: Tensor) -> Tensor:
        """Features (N, L F), linear between the 8 corners of a cell of each level."""
        scaled = (position[:, None].clamp(-1, 1) + 1) / 2 * self.resolution[:, None]  # (N, L, 3)
        cell = scaled.detach().floor()
        part = scaled - cell
        corner = cell.long()[:, :, None] + self.corners  # (N, L, 8, 3)
        x, y, z = (corner[..., axis] * prime for axis, prime in enumerate(PRIMES))
        level = torch.arange(len(self.resolution), device=position.device)[:, None]
        values = embedding((x ^ y ^ z) % self.size + self.size * level, self.table)  # (N, L, 8, F)
        x_side, y_side, z_side = torch.stack([1 - part, part], -1).unbind(2)  # (N, L, 2) each
        near = x_side[..., :, None, None] * y_side[..., None, :, None] * z_side[..., None, None, :]
        return (near.flatten(2)[..., None, :] @ values).flatten(1)


class IncidentField(nn.Module):
    """A perceptron of an encoded direction, into whose middle layer a position enters as it is.

    The middle layer is linear before its activation, so that each input's share of it is found by itself: ``middle`` of all
    directions, ``inserted`` of all positions, and ``finish`` of the sum for those pairs that are asked for.
    """

    def __init__(self, *, width: int, start: float, generator: torch.Generator) -> None:
        """``start``: what all outputs are at the start."""
        super().__init__()
        inputs = encoded(3, FREQUENCIES)
        self.front = perceptron([inputs, width, width])
        self.along, self.at = nn.Linear(width, width), nn.Linear(3, width, bias=False)
        self.back = perceptron([width, width, 3])
        for part in (self.front, self.along, self.back):
            initialise(part.to(generator.device), generator, math.sqrt(6))
        initialise(self.at.to(generator.device), generator)
        _start_constant(self.back, start, generator)

    def middle(self, direction: Tensor) -> Tensor:
        """The share (D, W) of directions (D, 3) in the middle layer."""
        return self.along(torch.relu(self.front(positional_encoding(direction, FREQUENCIES))))

    def inserted(self, position: Tensor) -> Tensor:
        """The share (N, W) of positions (N, 3)."""
        return self.at(position)

    def finish(self, middle: Tensor) -> Tensor:
        """The outputs (K, 3) of what the middle layer holds, (K, W)."""
        return self.back(torch.relu(middle))


def _start_constant(network: nn.Sequential, start: float, generator: torch.Generator) -> None:
    last = network[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.weight.uniform_(-LAST, LAST, generator=generator)
        last.bias.fill_(start)


class Neilf(nn.Module):
    """Everything that is trained. Positions are taken relative to the ``centre`` and ``radius`` of the object's bounding box."""

    centre: Tensor

    def __init__(self, options: NeilfppOptions, corners: Tensor, median: float, generator: torch.Generator) -> None:
        """``corners`` (2, 3) of the bounding box; ``median`` of the images, which an even light on a material of .5 explains."""
        super().__init__()
        brightness = max(median, 1e-3)
        share = min(brightness / BRIGHTEST, 0.9)

        def grid() -> HashGrid:
            return HashGrid(coarsest=8, finest=options.finest, generator=generator)

        def head(inputs: int, outputs: int, start: float) -> nn.Sequential:
            network = perceptron([inputs, options.width, options.width, outputs]).to(generator.device)
            initialise(network, generator, math.sqrt(6))
            _start_constant(network, start, generator)
            return network

        self.material_grid, self.outgoing_grid = grid(), grid()
        self.material_head = head(self.material_grid.outputs, 5, 0.0)
        self.outgoing_head = head(self.outgoing_grid.outputs + encoded(3, FREQUENCIES), 3, math.log(share / (1 - share)))
        self.incident_field = IncidentField(width=options.width, start=math.log10(brightness / 0.5), generator=generator)
        self.register_buffer("centre", corners.mean(0))
        self.radius = float((corners[1] - corners[0]).norm()) / 2

    def local(self, position: Tensor) -> Tensor:
        """Positions inside the unit ball."""
        return (position - self.centre) / self.radius

    def material(self, local: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Base colour (N, 3), roughness (N, 1) and metal (N, 1) at local positions (N, 3)."""
        found = torch.tanh(self.material_head(self.material_grid(local))) / 2 + 0.5
        colour, roughness, metallic = found.split((3, 1, 1), 1)
        return colour, LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * roughness, metallic

    def incident(self, local: Tensor, directions: Tensor, point: Tensor, direction: Tensor) -> Tensor:
        """Radiance (K, 3) that arrives at the ``point``-th local position (N, 3) from the ``direction``-th of directions (D, 3)."""
        field = self.incident_field
        at, along = field.inserted(local), field.middle(directions)
        logarithm: Tensor = field.finish(at.index_select(0, point) + along.index_select(0, direction))
        return torch.exp(math.log(10) * logarithm)

    def outgoing(self, local: Tensor, directions: Tensor) -> Tensor:
        """Radiance (N, 3) that local positions (N, 3) send along unit directions (N, 3)."""
        seen = torch.cat([self.outgoing_grid(local), positional_encoding(directions, FREQUENCIES)], 1)
        return BRIGHTEST * torch.sigmoid(self.outgoing_head(seen))
