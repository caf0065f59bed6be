"""A control variate of diffuse light: what the texels of an atlas see of the sky, which takes the place of most samples' noise.

The irradiance of a point, E = int V(w) L(w) cos(w) dw, is estimated from few samples, whose noise is mostly diffuse: they meet
bright and dark parts of the light by chance. The nearest texel t of the atlas of :mod:`ia_bench.render.indirect` sees nearly the
same: of cell k of the sky, whose solid angle is O_k, it has S_tk, the cosine-weighted solid angle that nothing hides. So

    E = E_t + int (V(w) cos(w) - c_t(w)) L(w) dw,    c_t(w) = S_tk / O_k in cell k,    E_t = int c_t L = sum_k S_tk L_k

holds whatever S is. E_t is known without noise, and only the difference, which is small, is sampled: the estimate stays
unbiased (a control variate; Glasserman 2003, section 4.1). It is differentiable in the light on both ways.

Samples have to reach all of c_t, and those of a point end at its horizon. So c_t is nothing in cells that are not wholly above
the texel's horizon by MARGIN, and a point whose normal is farther than that from its texel's goes without.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ia_bench.common.warp_launch import launch
from ia_bench.light.latlong import row_solid_angles
from ia_bench.render.estimator import DirectionSamples
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.warp_control import subtract

MARGIN = 0.15  # the sine of an angle: cells lie as much above the horizon of their texel, and normals of points no farther from its


class DiffuseControl:
    """What the N texels of an atlas see of the cells of the sky, safely above their horizons.

    Attributes:
        share: (N, cells), what of the atlas' operator S belongs to it; E_t is its product with the cells of a light.
    """

    def __init__(self, sky: Tensor, normal: Tensor, height: int) -> None:
        """``sky`` is S, (N, cells) of ``height`` rows and twice as many columns; ``normal`` (N, 3), unit, of the texels."""
        solid_angle = row_solid_angles(height, 2 * height).to(sky).repeat_interleave(2 * height)
        self._seen = torch.where(_above(normal, height), sky / solid_angle, 0).half()
        self.share = self._seen.float() * solid_angle  # of the same rounded values
        self._normal, self._height = normal, height

    def rows(self, nearest: Tensor, normal: Tensor, hit: Tensor) -> Tensor:
        """The texel of each of N points, (N,) int32; -1 for those that go without.

        ``nearest`` (N,) int32: the texel at the point; ``normal`` (N, 3) of the point; ``hit`` (N,) bool, whether there is one.
        """
        near = (self._normal[nearest] * normal).sum(-1) > math.sqrt(1 - MARGIN**2)
        return torch.where(near & hit, nearest, -1)

    def subtract(self, drawn: DirectionSamples, rows: Tensor, surface: SurfacePoints, blocked: Tensor) -> None:
        """Leave of the samples of points with ``rows`` what E_t lacks; ``blocked`` (N, 2 count) bool. Changes ``drawn``."""
        given = rows, surface.normal, self._seen, self._height, blocked.view(torch.uint8)
        launch(subtract, len(rows), *given, drawn.direction, drawn.texel, drawn.terms, device=rows.device)


def _above(normal: Tensor, height: int) -> Tensor:
    """Which cells lie wholly above the horizon of (N, 3) normals by MARGIN: (N, cells) bool."""
    theta = torch.arange(height + 1, device=normal.device) * (math.pi / height)
    phi = math.pi - torch.arange(2 * height + 1, device=normal.device) * (math.pi / height)
    sin, cos = torch.sin(theta)[:, None], torch.cos(theta)[:, None].expand(-1, len(phi))
    corners = torch.stack([sin * torch.cos(phi), sin * torch.sin(phi), cos], -1).to(normal)
    cosine = (normal @ corners.reshape(-1, 3).T).reshape(-1, height + 1, 2 * height + 1)
    return (-torch.nn.functional.max_pool2d(-cosine, 2, 1)).flatten(1) > MARGIN
