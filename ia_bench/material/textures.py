"""Albedo and roughness as textures over the mesh's UV."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ia_bench.common.warp_launch import launch
from ia_bench.material.warp_textures import look_up, look_up_adjoint


@dataclass
class Material:
    """Square textures, which may differ in size. Row 0 is v = 1.

    Attributes:
        albedo: (T, T, 3) in [0, 1], linear.
        roughness: (T', T', 1) in [MIN_ROUGHNESS, 1], perceptual.
        metallic: (T'', T'', 1) in [0, 1], None for a dielectric. It says how much of the albedo the specular lobe reflects
            at normal incidence instead of the diffuse one (the metallic workflow; Burley 2012).
    """

    albedo: Tensor
    roughness: Tensor
    metallic: Tensor | None = None


def fetch(texture: Tensor, uv: Tensor) -> Tensor:
    """Look up a texture (H, W, C) bilinearly at UV (..., 2): (..., C). Differentiable in the texture only."""
    found: Tensor = _Fetch.apply(texture.contiguous(), uv.detach().reshape(-1, 2).contiguous())
    return found.reshape(*uv.shape[:-1], texture.shape[-1])


class _Fetch(torch.autograd.Function):
    """A look-up and its transpose, of which either is the other's gradient."""

    @staticmethod
    def forward(ctx: Any, texture: Tensor, uv: Tensor) -> Tensor:  # noqa: ANN401 (torch's context)
        ctx.save_for_backward(uv)
        ctx.shape = texture.shape
        found = texture.new_empty(len(uv), texture.shape[-1])
        launch(look_up, len(uv), uv, texture, found, device=uv.device)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401 (torch's context)
        (uv,), texture = ctx.saved_tensors, gradients[0].new_zeros(ctx.shape)
        launch(look_up_adjoint, len(uv), uv, gradients[0].contiguous(), sums=[texture], device=uv.device)
        return texture, None


def splat(uv: Tensor, values: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Average (N, C) values into a texture by the bilinear weights of their (N, 2) UV, the transpose of :func:`fetch`.

    Returns the (size, size, C) averages, 0 where nothing fell, and the (size, size) total weights.
    """
    summed = values.new_zeros(size, size, values.shape[-1] + 1)
    weighed = torch.cat([values, torch.ones_like(uv[:, :1])], 1)
    launch(look_up_adjoint, len(uv), uv.contiguous(), weighed, sums=[summed], device=uv.device)
    total = summed[..., -1]
    return summed[..., :-1] / total.clamp_min(1e-30)[..., None], total


def fill_unobserved(texture: Tensor, observed: Tensor) -> Tensor:
    """Replace texels outside ``observed`` (T, T) bool by pull-push interpolation of the observed ones.

    Observed texels are returned unchanged. With nothing observed the texture itself is returned.
    """
    if bool(observed.all()) or not bool(observed.any()):
        return texture
    filled = _pull_push(_squared(torch.where(observed[..., None], texture, 0.0)), _squared(observed[..., None].to(texture.dtype)))
    return torch.where(observed[..., None], texture, _cropped(filled, len(texture)))


def _squared(texture: Tensor) -> Tensor:
    """A texture (T, T, C) as (1, C, P, P) with zeros beyond it; P is the next power of two, which can be halved down to 1."""
    size = len(texture)
    more = 2 ** math.ceil(math.log2(size)) - size
    return torch.nn.functional.pad(texture.permute(2, 0, 1)[None], (0, more, 0, more))


def _cropped(image: Tensor, size: int) -> Tensor:
    """The texture (size, size, C) that :func:`_squared` has brought into this form."""
    return image[0, :, :size, :size].permute(1, 2, 0)


def _pull_push(values: Tensor, weight: Tensor) -> Tensor:
    """Average premultiplied ``values`` down to one texel, then fill holes on the way up (after Gortler et al. 1996).

    A coarser texel is as certain as the share of its area that was observed, so that where little around a hole is known, it is
    filled more with the mean of all: sums of shares, as in the source, follow the neighbours, and are wrong by more in what
    photographs do not show (docs/log/few-photographs.md).
    """
    mean = values / weight.clamp_min(1e-12)
    if values.shape[-1] == 1:
        return mean
    pool = torch.nn.functional.avg_pool2d
    coarse = _pull_push(pool(values, 2), pool(weight, 2))
    up = torch.nn.functional.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    return torch.lerp(up, mean, weight)


def smooth_by_view_count(texture: Tensor, count: Tensor, even: float) -> Tensor:
    """Mix each texel of a texture (T, T, C) with what is around it, by its view count n (T, T): n^2 / (n^2 + even^2) is its own.

    This is pull-push interpolation (Gortler et al. 1996) of values of unequal certainty. What is around a texel is the coarser
    texture, whose texels are means weighted by the counts of their parts, count as often as all of them, and are mixed likewise.
    Where every count is 0, the texture itself is returned.
    """
    if not bool((count > 0).any()):
        return texture
    return _cropped(_mixed_with_coarser(_squared(texture), _squared(count[..., None]), even), len(texture))


def _mixed_with_coarser(mean: Tensor, count: Tensor, even: float) -> Tensor:
    if mean.shape[-1] == 1:
        return mean
    pool = torch.nn.functional.avg_pool2d
    average = pool(count, 2)
    coarse = _mixed_with_coarser(pool(mean * count, 2) / average.clamp_min(1e-12), 4 * average, even)
    around = torch.nn.functional.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    own = count.square()
    return torch.lerp(around, mean, own / (own + even**2).clamp_min(1e-30))
