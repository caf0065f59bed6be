"""Names what is not finite in a step: the tensor, and the views and pixels that are to blame."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ia_bench.material.textures import bilinear_taps
from ia_bench.methods.contract import Problem

NAMED = 3  # pixels or texels that a message names


def check_rendered(problem: Problem, value: Tensor, pixels: Tensor, renders: Mapping[str, Tensor]) -> None:
    """Raise FloatingPointError unless the ``value`` made of ``renders`` (B, C) at G-buffer entries (B,) is finite."""
    if bool(torch.isfinite(value)):
        return
    for name, values in renders.items():
        bad = ~torch.isfinite(values).all(-1)
        if bool(bad.any()):
            where = _views(problem, pixels[bad])
            raise FloatingPointError(f"the rendered {name} is NaN or Inf in {int(bad.sum())} of {len(bad)} pixels ({where})")
    raise FloatingPointError("the loss is NaN or Inf although every rendered pixel is finite")


def check_gradients(problem: Problem, gradients: Mapping[str, Tensor], pixels: Tensor) -> None:
    """Raise FloatingPointError unless the squares of gradients by G-buffer entries (B,) are finite: Adam keeps them as moments.

    The texels of a texture lead back to the pixels that fetch them; one of the light may shine on any.
    """
    for name, gradient in gradients.items():
        if bool(torch.isfinite(gradient.square().sum())):  # looking at every texel takes ten times as long
            continue
        bad = ~torch.isfinite(gradient.square()).all(-1)
        touched = pixels[:0] if name == "log_light" else pixels_that_fetch(problem, bad, pixels)
        texels = [f"row {row} column {column}" for row, column in torch.nonzero(bad).tolist()]
        where = _views(problem, touched) if len(touched) else _few(texels)
        what = f"the gradient of {name} is NaN, Inf or too large"
        raise FloatingPointError(f"{what} in {int(bad.sum())} of {bad.numel()} texels ({where})")


def pixels_that_fetch(problem: Problem, texels: Tensor, pixels: Tensor) -> Tensor:
    """Those of G-buffer entries (B,) one of whose points looks up one of ``texels`` (T, T) bool."""
    face = problem.gbuffer.face[pixels]
    uv = problem.renderer.surface.uv(face.clamp_min(0).long(), problem.gbuffer.barycentric[pixels])
    index, _ = bilinear_taps(uv, *texels.shape)
    return pixels[(texels.reshape(-1)[index].any(-1) & (face >= 0)).any(1)]


def _views(problem: Problem, pixels: Tensor) -> str:
    """Names of the views, and rows and columns, of the first few of G-buffer entries."""
    _, height, width = problem.gbuffer.shape
    names, flat = [view.name for view in problem.scene.train], problem.gbuffer.pixel[pixels].unique().tolist()
    return _few([f"view {names[n // (height * width)]} row {n // width % height} column {n % width}" for n in flat])


def _few(places: list[str]) -> str:
    more = len(places) - NAMED
    return "; ".join(places[:NAMED]) + (f"; {more} more" if more > 0 else "")
