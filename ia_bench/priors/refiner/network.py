"""What the refiner sees of a fit, and the network that corrects its material: a small U-Net at full resolution.

The albedo's level is divided out before the network sees anything. So it can say nothing about how bright the whole object is
painted, which photographs of an unknown light do not tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import PICTURES
from ia_bench.scenes.tensor_color import linear_to_srgb, srgb_to_linear

FEATURES = 22
"""Channels of :func:`see`: albedo (3), roughness, misfit, shine, residual and shading (3 each), spread, looks (2), normals (3),
visibility, places (2), mask."""
ALBEDO = 0.35
"""The albedo is multiplied such that this is its mean over the object."""
LARGEST_ALBEDO = 4.0
"""Values multiplied in this way are clipped here: larger ones are errors."""
LEAST_COVERAGE = 0.02
"""Premultiplied values are divided by the coverage of their pixel, or by this where it is less."""
EMPTY = 0.02
"""A pixel that the object covers no more than this shows nothing."""
LARGEST = 4.0
"""Misfit and shine are clipped here,"""
MOST_STOPS = 2.0
"""the residual and, multiplied as follows, the shading at so many up and down."""
SHADING_SCALE, SPREAD_SCALE = 0.3, 0.5
"""Stops of the shading, and how much photographs differ in it, are multiplied such that they are about as large as the rest."""
SURE = 0.2
"""At so many looks l the first of their two channels, l^2 / (l^2 + SURE^2), is a half."""
LOOKS_SCALE = 4
"""The log2 of 1 + looks is divided by this: 15 photographs that look straight at a place are a 1."""


@dataclass(frozen=True)
class RefinerConfig:
    """The network's shape.

    Attributes:
        channels: How many channels each level has, from full resolution down; multiples of 8.

    Raises:
        InputError: The values make no network.
    """

    channels: tuple[int, ...] = (32, 48, 64, 96)

    def __post_init__(self) -> None:
        if len(self.channels) < 2 or any(width < 8 or width % 8 for width in self.channels):
            raise InputError(f"network.channels: expected two or more multiples of 8, found {list(self.channels)}")

    @property
    def stride(self) -> int:
        """The sides of an image are multiples of this."""
        return 2 ** (len(self.channels) - 1)


@dataclass(frozen=True)
class Seen:
    """A fit as the network sees it.

    Attributes:
        features: (N, FEATURES, H, W), 0 where nothing is.
        albedo: (N, 3, H, W), the fit's, as on a display, at the mean ALBEDO.
        factor: (N, 1, 1, 1), by which it was brought there.
        roughness: (N, 1, H, W), the fit's.
        mask: (N, H, W, 1), coverage.
    """

    features: Tensor
    albedo: Tensor
    factor: Tensor
    roughness: Tensor
    mask: Tensor

    def corrected(self, change: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (N, H, W, 3), linear, and roughness (N, H, W, 1), premultiplied.

        ``change`` (N, 4, H, W) is that of the albedo's display values and of the roughness.
        """
        albedo = srgb_to_linear((self.albedo + change[:, :3]).clamp_min(0)).movedim(1, -1) / self.factor
        roughness = (self.roughness + change[:, 3:]).clamp(0, 1).movedim(1, -1)
        return albedo * self.mask, roughness * self.mask


def see(pictures: Mapping[str, Tensor]) -> Seen:
    """The PICTURES (N, H, W, C) of a fit as :meth:`ia_bench.priors.contract.Refiner.refine` has them."""
    mask = pictures["mask"]
    straight = 1 / mask.clamp_min(LEAST_COVERAGE)
    inside = (mask > 0.5).float()
    whole = {name: pictures[name] * straight for name in PICTURES}
    factor = ALBEDO / _mean(whole["albedo"], inside)
    shown = linear_to_srgb((whole["albedo"] * factor).clamp(0, LARGEST_ALBEDO))
    shading, looks = whole["shading"], whole["looks"].clamp_min(0)
    spread = (whole["squared_shading"] - shading.mean(-1, keepdim=True).square()).clamp_min(0).sqrt()
    channels = [
        shown,
        whole["roughness"],
        whole["misfit"].clamp(0, LARGEST),
        whole["shine"].clamp(0, LARGEST),
        whole["residual"].clamp(-MOST_STOPS, MOST_STOPS),
        (SHADING_SCALE * shading).clamp(-MOST_STOPS, MOST_STOPS),
        SPREAD_SCALE * spread,
        looks.square() / (looks.square() + SURE**2),
        torch.log2(1 + looks) / LOOKS_SCALE,
        whole["normals"],
        whole["visibility"],
        whole["places"],
        mask,
    ]
    features = torch.cat(channels, -1) * (mask > EMPTY)
    first = [each.movedim(-1, 1).contiguous() for each in (features, shown, whole["roughness"])]
    return Seen(first[0], first[1], factor, first[2], mask)


def _mean(values: Tensor, inside: Tensor) -> Tensor:
    """(N, 1, 1, 1): the mean of (N, H, W, 3) over pixels and channels, at least 1e-4."""
    total = (values * inside).sum((1, 2, 3)) / (3 * inside.sum((1, 2, 3))).clamp_min(1)
    return total.clamp_min(1e-4)[:, None, None, None]


class RefinerNetwork(nn.Module):
    """A U-Net (Ronneberger et al. 2015) of residual blocks. Untrained it changes nothing."""

    def __init__(self, config: RefinerConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.channels
        pairs = list(zip(widths, widths[1:], strict=False))
        self.conv_in = nn.Conv2d(FEATURES, widths[0], 3, padding=1)
        self.descending = nn.ModuleList([_Block(width) for width in widths[:-1]])
        self.coarser = nn.ModuleList([nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairs])
        self.lowest = nn.Sequential(_Block(widths[-1]), _Block(widths[-1]))
        self.finer = nn.ModuleList([nn.Conv2d(coarse, fine, 1) for fine, coarse in pairs])
        self.ascending = nn.ModuleList([_Block(width) for width in widths[:-1]])
        self.conv_out = nn.Conv2d(widths[0], 4, 1)
        nn.init.zeros_(self.conv_out.weight)
        nn.init.zeros_(self.conv_out.bias)  # type: ignore[arg-type]

    def forward(self, features: Tensor) -> Tensor:
        """The change (N, 4, H, W) of the albedo's display values and of the roughness, from features (N, FEATURES, H, W).

        Sides are multiples of the config's stride.
        """
        hidden, passed = self.conv_in(features), []
        for block, coarser in zip(self.descending, self.coarser, strict=True):
            hidden = block(hidden)
            passed.append(hidden)
            hidden = coarser(hidden)
        hidden = self.lowest(hidden)
        for level in reversed(range(len(passed))):
            up = F.interpolate(self.finer[level](hidden), scale_factor=2, mode="nearest")
            hidden = self.ascending[level](up + passed[level])
        change: Tensor = self.conv_out(hidden)
        return change


class _Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(8, width)
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, values: Tensor) -> Tensor:
        """(N, C, H, W) of the same."""
        changed: Tensor = values + self.second(F.silu(self.first(F.silu(self.norm(values)))))
        return changed
