"""A control variate of diffuse light: what the texels of an atlas see of the sky, which takes the place of most samples' noise.

The irradiance of a point, E = int V(w) L(w) (n w) dw, is estimated from few samples, whose noise is mostly diffuse: they meet
bright and dark parts of the light by chance. The nearest texel of the atlas of :mod:`ia_bench.render.indirect` sees nearly the
same of the sky: its cell k, around the direction d_k and of the power P_k = int L dw, is free (v_k = 1) or not. So

    E = sum_k v_k (n d_k) P_k + int (V(w) (n w) - c(w)) L(w) dw,    c(w) = v_k (n d_k) in cell k

holds whatever v is. The sum is known without noise, and only the difference, which is small, is sampled: the estimate stays
unbiased (a control variate; Glasserman 2003, section 4.1). It is differentiable in the light on both ways.

Samples have to reach all of c, and those of a point end at its horizon: cells that are not wholly above it are left out.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ia_bench.common.warp_launch import launch
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.render.estimator import DirectionSamples
from ia_bench.render.warp_control import known, known_adjoint, subtract


class DiffuseControl:
    """Which cells of the sky the texels of an atlas see, and what that says of points beside them."""

    def __init__(self, free: Tensor, height: int) -> None:
        """``free`` (texels, cells) bool, of a sky of ``height`` rows of cells, 16 or a multiple, and twice as many columns."""
        self._free, self._height = free.to(torch.uint8).reshape(-1), height
        self._axes = texel_centres(height, 2 * height).reshape(-1, 3).T.reshape(-1).float().to(free.device)
        self._least = math.pi / (math.sqrt(2) * height)  # as a cosine: no direction of a cell is farther from its middle
        self._solid_angle = row_solid_angles(height, 2 * height).repeat_interleave(2 * height).float().to(free.device)

    def at(self, sky: Tensor, row: Tensor, normal: Tensor) -> ControlAtPoints:
        """The control of N points.

        Args:
            sky: (cells, 3), the mean radiance of the light in each cell.
            row: (N,) int32, the texel that each point is nearest to, -1 for points that go without.
            normal: (N, 3), unit.
        """
        return ControlAtPoints(sky, self._solid_angle, (row, normal, self._free, self._axes, self._least), self._height)


class ControlAtPoints(NamedTuple):
    """What of the irradiance of N points is known, and how their samples estimate the rest."""

    sky: Tensor  # (cells, 3), mean radiance; differentiable
    solid_angle: Tensor  # (cells,)
    fixed: tuple[Any, ...]  # what all kernels take
    height: int

    def irradiance(self) -> Tensor:
        """The sum above, (N, 3); differentiable in the light."""
        found: Tensor = _Known.apply((self.solid_angle[:, None] * self.sky).T.contiguous(), *self.fixed)
        return found

    def subtract(self, drawn: DirectionSamples, blocked: Tensor) -> None:
        """Leave of the samples what :meth:`irradiance` lacks; ``blocked`` (N, 2 count) bool. Changes ``drawn`` in place."""
        given = *self.fixed, self.height, blocked.view(torch.uint8), drawn.direction, drawn.texel, drawn.terms
        launch(subtract, len(blocked), *given, device=blocked.device)


class _Known(torch.autograd.Function):
    """:func:`ia_bench.render.warp_control.known` and its adjoint; ``power`` (3, cells)."""

    @staticmethod
    def forward(ctx: Any, power: Tensor, *fixed: Any) -> Tensor:  # noqa: ANN401 (torch's context, and what the kernels take)
        row, normal = fixed[:2]
        found = torch.empty_like(normal)
        launch(known, len(row), *fixed, power.shape[1], power.view(-1), found, device=row.device)
        ctx.fixed, ctx.size = fixed, power.shape
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401 (torch's context)
        row = ctx.fixed[0]
        of_power = torch.zeros(ctx.size, device=row.device)
        given = *ctx.fixed, ctx.size[1], gradients[0].contiguous()
        launch(known_adjoint, len(row), *given, sums=[of_power.view(-1)], device=row.device)
        return of_power, None, None, None, None, None
