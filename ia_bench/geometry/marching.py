"""What rays gather on their way through a grid of signed distances, differentiably (NeuS: Wang et al. 2021).

Instead of a surface that a ray hits or misses there is a soft one of some ``width``: with the logistic function S, a segment of a
ray from distance f_i to f_{i+1} stops the share 1 - S(f_{i+1} / width) / S(f_i / width) of what arrives there, none where it leads
outward. So a little of what lies before and behind the surface is seen too, and the colours there tell where the surface belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import maximum_filter
from torch import Tensor
from torch.autograd.function import FunctionCtx

from ia_bench.common.warp_launch import launch
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.warp_march import gather, gather_adjoint
from ia_bench.scenes.scene import View

BESIDE = 2  # pixels around a mask that are looked at too: they say that nothing is there


@dataclass(frozen=True)
class Rays:
    """N rays in a grid's frame, lengths in its cells: ``origins`` and unit ``directions`` (N, 3), ``near`` and ``far`` (N,)."""

    origins: Tensor
    directions: Tensor
    near: Tensor
    far: Tensor

    def chosen(self, indices: Tensor) -> Rays:
        """Some of the rays, as copies."""
        return Rays(self.origins[indices], self.directions[indices], self.near[indices], self.far[indices])


@dataclass(frozen=True)
class Pixels:
    """What photographs show of an object and right beside it, N pixels of all views one after another.

    ``colour`` (N, 3) linear, premultiplied; ``mask`` (N,) coverage; ``colour_known`` and ``mask_known`` (N,), 0 or 1;
    ``view`` (N,) the number of the photograph, ``place`` (N, 2) column and row in it.
    """

    rays: Rays
    colour: Tensor
    mask: Tensor
    colour_known: Tensor
    mask_known: Tensor
    view: Tensor
    place: Tensor


def pixels_of(views: Sequence[View], grid: DistanceGrid) -> Pixels:
    """The pixels of the views whose rays meet the box of the grid, up to a few beside the masks."""
    parts = [_of_view(number, view, grid) for number, view in enumerate(views)]
    origins, directions, near, far, *rest = (torch.cat(values) for values in zip(*parts, strict=True))
    return Pixels(Rays(origins, directions, near, far), *rest)


def _of_view(number: int, view: View, grid: DistanceGrid) -> tuple[Tensor, ...]:
    camera = view.camera
    rows, columns = np.nonzero(maximum_filter(view.mask > 0, 2 * BESIDE + 1))
    along = camera.rays(columns + 0.5, rows + 0.5)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    origin = np.broadcast_to((camera.position - grid.low.numpy()) / grid.step, along.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([-origin / along, (np.array(grid.values.shape) - 1 - origin) / along])
    near, far = np.fmax(np.fmax.reduce(sides.min(0), axis=-1), 1e-3), np.fmin.reduce(sides.max(0), axis=-1)
    met = far > near
    of_pixels = (view.image, view.mask, view.known, view.known | (view.mask > 0))
    values = origin, along, near, far, *(values[rows, columns] for values in of_pixels), np.stack([columns, rows], -1) + 0.5
    *floats, place = (torch.from_numpy(np.ascontiguousarray(one[met], np.float32)) for one in values)
    return *floats, torch.full((len(place),), number), place


def gathered(
    values: Tensor, features: Tensor, rays: Rays, width: float, stride: float, of_features: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """What N rays gather of ``features`` (X, Y, Z, C) in ``values`` (X, Y, Z), distances in cells: each weighted by its share.

    ``width`` of the surface and ``stride`` of the rays near it are in cells. Returns the sum of features (N, C), of shares, which
    is the opacity (N,), and of distances along the ray (N,). How rays skip empty space carries no gradient.
    ``of_features``: what gradients of features are added to, if not to one of autograd's own, which is made anew each time.
    """
    found: tuple[Tensor, Tensor, Tensor] = _Gather.apply(values, features, rays, width, stride, of_features)
    return found


class _Gather(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, values: Tensor, features: Tensor, rays: Rays, width: float, stride: float, of_features: Tensor | None
    ) -> tuple[Tensor, ...]:
        count = len(rays.near)
        outputs = features.new_empty(count, features.shape[-1]), values.new_empty(count), values.new_empty(count)
        values, features = values.contiguous(), features.contiguous()
        of_rays = rays.origins, rays.directions, rays.near, rays.far
        launch(gather, count, *of_rays, values, features, width, stride, *outputs, device=values.device)
        ctx.save_for_backward(values, features, *outputs)  # outputs in an attribute would hold, for ever, what holds them
        ctx.given = of_rays, width, stride, of_features  # type: ignore[attr-defined]
        return outputs

    @staticmethod
    def backward(ctx: FunctionCtx, *of_outputs: Tensor) -> tuple[Tensor | None, ...]:
        of_rays, width, stride, of_features = ctx.given  # type: ignore[attr-defined]
        values, features, *outputs = ctx.saved_tensors  # type: ignore[attr-defined]
        sums = torch.zeros_like(values), torch.zeros_like(features) if of_features is None else of_features
        of_each = [one.contiguous() for one in of_outputs]
        given = *of_rays, values, features, width, stride, *outputs, *of_each
        launch(gather_adjoint, len(of_each[1]), *given, sums=sums, device=values.device)
        return sums[0], sums[1] if of_features is None else None, None, None, None, None
