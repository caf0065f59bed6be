"""Predictions of all views merged in texture space: first one scale per view, then a robust mean in every texel."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.material.textures import fetch, fill_unobserved, splat
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.losses import decode, encode
from ia_bench.render.renderer import texture_images

CELLS = 128  # cells along a side of the atlas in which views are compared for their scale
SCALE_ROUNDS = 10  # of reweighted least squares
MEAN_ROUNDS = 3  # of the robust mean; more would follow noise where texels are finer than pixels
OUTLIER = 0.1  # difference, in log or in the prior's encoding, from which a view counts less
DARKEST = 0.01  # albedo whose log is still compared


@torch.no_grad()
def fuse_views(
    problem: Problem, target: Tensor, weight: Tensor, encoding: str, *, align: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Fuse premultiplied linear albedo (P, 3) with weights (P, 1) of all pixels into one texture, seen again by every view.

    Pixels of weight zero, and those that an edge crosses, contribute nothing. ``align``: the scale of each view is unknown
    and solved for (the geometric mean of all scales stays). Returns the fused targets (P, 3), premultiplied; the standard
    deviation (P, 1) of the views around them, in ``encoding``; and 1 (P, 1) where some view contributed, else 0, where the
    target is interpolated.
    """
    gbuffer, surface, size = problem.gbuffer, problem.renderer.surface, problem.plan.texture
    hit = gbuffer.face >= 0
    used = hit.all(1) & (weight[:, 0] > 0)
    uv = surface.uv(gbuffer.face.clamp_min(0).long(), gbuffer.barycentric)  # (P, S, 2)
    first = uv[torch.arange(len(uv), device=uv.device), hit.int().argmax(1)]
    cell = _cells(first)
    view = (gbuffer.pixel // (gbuffer.shape[1] * gbuffer.shape[2]))[used]
    values, importance = target[used], weight[used]
    if align:
        log = torch.log(values.mean(-1).clamp_min(DARKEST))
        scales = view_scales(log, importance[:, 0], cell[used], view, gbuffer.shape[0])
        values = values * torch.exp(scales)[view][:, None]
    texture, residual = _robust_mean(uv[used], encode(values, encoding), importance, size)
    variance, _ = _mean(uv[used], (residual**2).mean(-1, keepdim=True), importance, size)
    linear = decode(texture, encoding).clamp(0, 1)
    fused = problem.pixels_of(texture_images(surface, gbuffer, linear))
    seen_by = _views_in_cells(cell[used], view, gbuffer.shape[0])[cell][:, None]
    # The variance of n views around their own mean is too small, and zero for one: the average over all texels stands
    # in for the missing degree of freedom.
    typical = (residual**2).sum() / max(residual.numel(), 1)  # none where the object fills no pixel
    around = (fetch(variance, first) * seen_by + typical) / seen_by.clamp_min(1)
    return fused, around.sqrt(), (seen_by > 0).float()


def view_scales(log: Tensor, weight: Tensor, cell: Tensor, view: Tensor, views: int) -> Tensor:
    """Log scales (V,) of mean zero that make the views agree best on the log albedo (N,) of the cells (N,) they share.

    A robust two-way fit, log + scale[view] = value[cell]: least squares in which the cell values are eliminated, solved
    exactly and reweighted toward absolute residuals. Views that share no cell with the others keep the scale zero.
    """
    cells = CELLS * CELLS
    index = cell * views + view
    count = torch.zeros(cells * views, device=log.device).index_add_(0, index, weight).reshape(cells, views).double()
    total = torch.zeros(cells * views, device=log.device).index_add_(0, index, weight * log).reshape(cells, views)
    shared = (count > 0).sum(1) > 1
    count, total = count[shared], total[shared].double()
    mean = total / count.clamp_min(1e-12)
    scales, robust = torch.zeros(views, dtype=torch.float64, device=log.device), count
    for _ in range(SCALE_ROUNDS):
        in_cell = robust.sum(1, keepdim=True).clamp_min(1e-12)
        centre = (robust * mean).sum(1, keepdim=True) / in_cell
        normal = torch.diag(robust.sum(0)) - robust.T @ (robust / in_cell)
        scales = -torch.linalg.pinv(normal, hermitian=True, rtol=1e-9) @ (robust * (mean - centre)).sum(0)
        aligned = mean + scales
        residual = aligned - (robust * aligned).sum(1, keepdim=True) / in_cell
        robust = count / residual.abs().clamp_min(OUTLIER)
    return scales.float()


def _robust_mean(uv: Tensor, values: Tensor, weight: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The texture (size, size, C) whose box-filtered pixels come near to the values, and what remains of these, (N, C).

    Pixels have values (N, C), weights (N, 1) and S points (N, S, 2). Every round adds the mean of what remains (iterative
    back-projection: a mean alone would blur by a pixel and a texel), with Cauchy's weights against outliers.
    """
    texture = torch.zeros(size, size, values.shape[-1], device=uv.device)
    residual, robust = values, weight
    for _ in range(MEAN_ROUNDS):
        correction, total = _mean(uv, residual, robust, size)
        texture = texture + correction
        residual = values - fetch(texture, uv).mean(1)
        robust = weight / (1 + (residual**2).mean(-1, keepdim=True) / OUTLIER**2)
    return fill_unobserved(texture, total > 0), residual


def _mean(uv: Tensor, values: Tensor, weight: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Averages (size, size, C) of (N, C) values at points (N, S, 2), weighted (N, 1), and where anything fell, (size, size)."""
    points = uv.shape[1]
    weighted = torch.cat([values * weight, weight], -1).repeat_interleave(points, 0)
    splatted, total = splat(uv.reshape(-1, 2), weighted, size)
    return splatted[..., :-1] / splatted[..., -1:].clamp_min(1e-12), total


def _cells(uv: Tensor) -> Tensor:
    """Cell (N,) of the atlas that (N, 2) UV fall in."""
    column, row = (uv * CELLS).long().clamp(0, CELLS - 1).unbind(-1)
    return row * CELLS + column


def _views_in_cells(cell: Tensor, view: Tensor, views: int) -> Tensor:
    """How many views see each cell: (CELLS^2,) float."""
    seen = torch.zeros(CELLS * CELLS * views, device=cell.device)
    seen[cell * views + view] = 1.0
    return seen.reshape(-1, views).sum(1)
