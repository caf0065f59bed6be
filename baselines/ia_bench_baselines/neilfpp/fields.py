"""The three networks of NeILF++: material, incident light and the light that the surface sends out."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ia_bench_baselines.common.networks import Sine, encoded, initialise_siren, positional_encoding
from ia_bench_baselines.neilfpp.method import LEAST_ROUGHNESS, NeilfppOptions

FREQUENCIES = 6  # of the positional encoding of a network's first input
LAST = 1e-5  # bound of the last layer's weights at the start, so that a field starts constant
BRIGHTEST = 3.0  # radiance that the surface light field can reach


class SineField(nn.Module):
    """A SIREN of one encoded input, which enters at the first and at the middle layer, and of another that enters at the middle.

    The middle layer is linear before its sine, so that each input's share of it is found by itself: ``middle`` of all of the
    first inputs, ``inserted`` of all of the second ones, and ``finish`` of the sum for those pairs that are asked for.
    """

    def __init__(self, outputs: int, *, width: int, layers: int, start: float, second: bool, generator: torch.Generator) -> None:
        """``start``: what all outputs are at the start; ``second``: whether there is a second input, of 3 channels."""
        super().__init__()
        first = encoded(3, FREQUENCIES)
        front = layers // 2

        def sines(sizes: list[int]) -> list[nn.Module]:
            return [part for size in sizes for part in (nn.Linear(size, width), Sine())]

        self.front = nn.Sequential(*sines([first, *[width] * (front - 1)]))
        self.centre = nn.Linear(width + first + (3 if second else 0), width)
        self.back = nn.Sequential(Sine(), *sines([width] * (layers - front - 1)))
        self.last = nn.Linear(width, outputs)
        self.to(generator.device)
        initialise_siren(self.front, generator)
        initialise_siren(self.centre, generator, first=False)
        initialise_siren(self.back, generator, first=False)
        with torch.no_grad():
            self.last.weight.uniform_(-LAST, LAST, generator=generator)
            self.last.bias.fill_(start)

    def middle(self, first: Tensor) -> Tensor:
        """The share (N, W) of the first inputs (N, 3) in the middle layer."""
        code = positional_encoding(first, FREQUENCIES)
        known = torch.cat([self.front(code), code], 1)
        return known @ self.centre.weight[:, : known.shape[1]].T + self.centre.bias

    def inserted(self, second: Tensor) -> Tensor:
        """The share (N, W) of the second inputs (N, 3)."""
        return second @ self.centre.weight[:, -3:].T

    def finish(self, middle: Tensor) -> Tensor:
        """The outputs (N, C) of what the middle layer holds, (N, W)."""
        found: Tensor = self.last(self.back(middle))
        return found


class Neilf(nn.Module):
    """Everything that is trained. Positions are taken relative to the ``centre`` and ``radius`` of the object's bounding box."""

    centre: Tensor

    def __init__(self, options: NeilfppOptions, corners: Tensor, median: float, generator: torch.Generator) -> None:
        """``corners`` (2, 3) of the bounding box; ``median`` of the images, which an even light on a material of .5 explains."""
        super().__init__()
        brightness = max(median, 1e-3)
        share = min(brightness / BRIGHTEST, 0.9)

        def field(outputs: int, width: int, start: float, *, second: bool = True) -> SineField:
            return SineField(outputs, width=width, layers=options.layers, start=start, second=second, generator=generator)

        self.material_field = field(5, options.material_width, 0.0, second=False)
        self.incident_field = field(3, options.width, math.log10(brightness / 0.5))
        self.outgoing_field = field(3, options.width, math.log(share / (1 - share)))
        self.register_buffer("centre", corners.mean(0))
        self.radius = float((corners[1] - corners[0]).norm()) / 2

    def local(self, position: Tensor) -> Tensor:
        """Positions inside the unit ball."""
        return (position - self.centre) / self.radius

    def material(self, local: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Base colour (N, 3), roughness (N, 1) and metal (N, 1) at local positions (N, 3)."""
        field = self.material_field
        colour, roughness, metallic = (torch.tanh(field.finish(field.middle(local))) / 2 + 0.5).split((3, 1, 1), 1)
        return colour, LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * roughness, metallic

    def incident(self, local: Tensor, directions: Tensor, point: Tensor, direction: Tensor) -> Tensor:
        """Radiance (K, 3) that arrives at the ``point``-th local position (N, 3) from the ``direction``-th of directions (D, 3)."""
        field = self.incident_field
        at, along = field.inserted(local), field.middle(directions)
        logarithm: Tensor = field.finish(at.index_select(0, point) + along.index_select(0, direction))
        return torch.exp(math.log(10) * logarithm)

    def outgoing(self, local: Tensor, directions: Tensor) -> Tensor:
        """Radiance (N, 3) that local positions (N, 3) send along unit directions (N, 3)."""
        field = self.outgoing_field
        return BRIGHTEST * torch.sigmoid(field.finish(field.middle(local) + field.inserted(directions)))
