"""Spec-Net, Normal-Net and Light-Net at half the original's widths, for pictures of 64 x 64."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ia_bench_baselines.common.pictures import SIDE
from ia_bench_baselines.yi.shading import normals_of, shading

INPUTS = 4  # colour and mask
WIDTHS = (8, 16, 32, 64, 64)
LOWEST = SIDE // 2 ** (len(WIDTHS) - 1)  # pixels a side of the lowest features
FRONTAL = (0.8, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The light that an untrained Light-Net finds in any picture: from all around, and more of it from the camera's side."""


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), nn.InstanceNorm2d(outputs), nn.ReLU())


class Encoder(nn.Module):
    """Convolutions that halve the picture at every width after the first, and two more at the lowest level."""

    def __init__(self) -> None:
        super().__init__()
        before = (INPUTS, *WIDTHS[:-1])
        self.levels = nn.ModuleList(_block(a, b, 1 if k == 0 else 2) for k, (a, b) in enumerate(zip(before, WIDTHS, strict=True)))
        self.middle = nn.Sequential(_block(WIDTHS[-1], WIDTHS[-1]), _block(WIDTHS[-1], WIDTHS[-1]))

    def forward(self, picture: Tensor) -> list[Tensor]:
        """Features of every level, finest first, and the lowest level beside what the middle makes of it."""
        features = [picture]
        for level in self.levels:
            features.append(level(features[-1]))
        features[-1] = torch.cat([self.middle(features[-1]), features[-1]], 1)
        return features[1:]


class UNet(nn.Module):
    """The encoder, and a decoder that enlarges bilinearly and sees the encoder's features of each level; tanh at the end.

    The original normalises each picture once more before the tanh, which gives every prediction one mean and one spread. A matt
    and a glossy object would have equally much specular shading; it is left out.
    """

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.encoder = Encoder()
        finer = list(reversed(WIDTHS))[1:]
        self.levels = nn.ModuleList(_block(2 * coarse, fine) for coarse, fine in zip(reversed(WIDTHS), finer, strict=False))
        self.output = nn.Sequential(_block(2 * WIDTHS[0], WIDTHS[0]), nn.Conv2d(WIDTHS[0], outputs, 3, 1, 1), nn.Tanh())

    def forward(self, picture: Tensor) -> Tensor:
        """(N, 4, S, S) to (N, outputs, S, S) in [-1, 1]."""
        *features, current = self.encoder(picture)
        for level, beside in zip(self.levels, reversed(features), strict=True):
            larger = F.interpolate(level(current), scale_factor=2, mode="bilinear", align_corners=False)
            current = torch.cat([larger, beside], 1)
        found: Tensor = self.output(current)
        return found


class LightNet(nn.Module):
    """The encoder and a small perceptron from its lowest features to nine coefficients.

    The features keep their 4 x 4 places, since where a picture is bright is what tells its light. The original's perceptron has
    134 million weights in its first layer; this one has 64 units.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        last = nn.Linear(64, 9)
        self.head = nn.Sequential(nn.Linear(2 * WIDTHS[-1] * LOWEST**2, 64), nn.ReLU(), last)
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias.copy_(torch.tensor(FRONTAL))

    def forward(self, picture: Tensor) -> Tensor:
        """(N, 4, S, S) to (N, 9)."""
        found: Tensor = self.head(self.encoder(picture)[-1].flatten(1))
        return found


class InverseRendering(nn.Module):
    """The three networks, and how they follow each other."""

    def __init__(self) -> None:
        super().__init__()
        self.specular, self.normal, self.light = UNet(3), UNet(2), LightNet()

    def separate(self, picture: Tensor) -> Tensor:
        """Specular shading (N, 3, S, S) of a picture (N, 4, S, S), in display values: I - S is the diffuse picture."""
        found = 0.5 + 0.5 * self.specular(picture)
        return found * (picture[:, 3:] > 0)

    def decompose(self, diffuse: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Albedo (N, 3, S, S) without an upper end, normals and shading of a ``diffuse`` picture in display values."""
        inside = mask > 0
        picture = torch.cat([torch.where(inside, 2 * diffuse - 1, 0.0), mask], 1)
        normals = normals_of(self.normal(picture))
        grey = shading(normals, self.light(picture))
        return diffuse / grey * inside, normals, grey
