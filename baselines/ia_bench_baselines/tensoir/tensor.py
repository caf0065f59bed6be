"""A vector-matrix tensor (TensoRF, Chen et al. 2022): a field over a cube as a sum of planes times lines."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample, interpolate

PLANES = ((0, 1), (0, 2), (1, 2))  # the axes of each plane ...
LINES = (2, 1, 0)  # ... and of the line that it is multiplied by
START = 0.1  # standard deviation of all values at the start


class VectorMatrix(nn.Module):
    """Features of points in [-1, 1]^3, each the product of a plane's value and a line's: 3 R of them.

    It is refined once. The fine tensor is the coarse one, interpolated and from then on held, plus what is trained, which starts
    at 0: the same as training interpolated values.
    """

    def __init__(self, components: int, coarse: int, fine: int, generator: torch.Generator) -> None:
        """``components`` (R) of each of the three pairs; ``coarse`` and ``fine`` cells along a side."""
        super().__init__()
        device = generator.device

        def drawn(*shape: int) -> nn.Parameter:
            return nn.Parameter(START * torch.randn(shape, generator=generator, device=device))

        self.coarse_planes, self.coarse_lines = drawn(3, components, coarse, coarse), drawn(3, components, coarse, 1)
        self.fine_planes = nn.Parameter(torch.zeros(3, components, fine, fine, device=device))
        self.fine_lines = nn.Parameter(torch.zeros(3, components, fine, 1, device=device))
        self._held: tuple[Tensor, Tensor] | None = None

    def coarse(self) -> list[nn.Parameter]:
        """What is trained before :meth:`refine`."""
        return [self.coarse_planes, self.coarse_lines]

    def fine(self) -> list[nn.Parameter]:
        """What is trained after it."""
        return [self.fine_planes, self.fine_lines]

    def refine(self) -> None:
        """Go on with the fine tensor."""
        pairs = (self.coarse_planes, self.fine_planes), (self.coarse_lines, self.fine_lines)
        planes, lines = (
            interpolate(coarse.detach(), list(fine.shape[2:]), mode="bilinear", align_corners=True) for coarse, fine in pairs
        )
        self._held = planes, lines

    def values(self) -> tuple[Tensor, Tensor]:
        """Planes (3, R, G, G), whose columns belong to the first of their axes, and lines (3, R, G, 1), as they are now."""
        if self._held is None:
            return self.coarse_planes, self.coarse_lines
        return self._held[0] + self.fine_planes, self._held[1] + self.fine_lines

    def forward(self, position: Tensor) -> Tensor:
        """Features (N, 3 R) at positions (N, 3); beyond the cube its border is repeated."""
        planes, lines = self.values()
        across = torch.stack([position[:, axes] for axes in PLANES])[:, :, None]  # (3, N, 1, 2)
        along = torch.stack([position[:, axis] for axis in LINES])[:, :, None]
        along = torch.stack([torch.zeros_like(along), along], -1)
        found = _looked_up(planes, across) * _looked_up(lines, along)  # (3, R, N, 1)
        return found[..., 0].flatten(0, 1).T

    def variation(self) -> Tensor:
        """Twice the mean squared difference between neighbouring values, summed over planes and lines and their axes."""
        planes, lines = self.values()
        steps = planes.diff(dim=2), planes.diff(dim=3), lines.diff(dim=2)
        return 2 * torch.stack([step.square().mean() for step in steps]).sum()


def _looked_up(grid: Tensor, place: Tensor) -> Tensor:
    return grid_sample(grid, place, mode="bilinear", padding_mode="border", align_corners=True)
