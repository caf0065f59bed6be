"""A step in which a value is not finite: it is not taken, what was not finite is named."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ia_bench.material.textures import bilinear_taps
from ia_bench.methods.contract import Problem

PATIENCE = 10  # bad steps in a row that end a fit: one is bad luck of its samples, ten are not
NAMED = 3  # pixels or texels that a message names


class StepGuard:
    """Looks for NaN and Inf in a step's loss, gradients and result, and keeps the parameters from before the step.

    Every check raises FloatingPointError naming the tensor and, where it can be told, the views and pixels. The texels of a
    texture lead back to the pixels of the batch that fetch them; a texel of the light may shine on any pixel.

    ``skipped``: steps not taken so far; ``in_a_row``: how many of them came last, without a good step between.
    """

    def __init__(self, problem: Problem, parameters: Mapping[str, Tensor], beside: Mapping[str, Tensor] | None = None) -> None:
        """``parameters``: what the optimiser changes in place, textures (T, T, C) by name and "log_light" (H, W, 3).

        ``beside``: what else a step changes; it is taken back with them, and not looked at.
        """
        self._problem, self._parameters = problem, parameters
        self._taken_back = {**parameters, **(beside or {})}
        self._kept = {name: parameter.detach().clone() for name, parameter in self._taken_back.items()}
        self.skipped = self.in_a_row = 0

    @torch.no_grad()
    def keep(self) -> None:
        """Remember the parameters: what :meth:`back_off` goes back to."""
        for name, parameter in self._taken_back.items():
            self._kept[name].copy_(parameter)

    @torch.no_grad()
    def back_off(self) -> None:
        """Take the step back. The optimiser's moments stay: only finite gradients, with finite squares, ever reach them."""
        for name, parameter in self._taken_back.items():
            parameter.copy_(self._kept[name])

    def check_loss(self, loss: Tensor, pixels: Tensor, causes: Mapping[str, Tensor]) -> None:
        """The loss of G-buffer entries (B,), and which of its (B, C) ``causes`` is not finite, the first to blame first."""
        if bool(torch.isfinite(loss)):
            return
        for name, values in causes.items():
            bad = ~torch.isfinite(values).all(-1)
            if bool(bad.any()):
                raise FloatingPointError(f"{name} is NaN or Inf in {_of(bad)} pixels ({self._views(pixels[bad])})")
        raise FloatingPointError("the loss is NaN or Inf although every rendered pixel is finite")

    def check_gradients(self, gradients: Mapping[str, Tensor], pixels: Tensor) -> None:
        """The gradients of parameters after a backward pass over G-buffer entries (B,); Adam squares them, which must be finite."""
        for name, gradient in gradients.items():
            if bool(torch.isfinite(gradient.square().sum())):
                continue
            bad = ~torch.isfinite(gradient.square()).all(-1)
            place = "their squares add up to Inf"
            if bool(bad.any()):
                touched = pixels[:0] if name == "log_light" else self._pixels_that_fetch(bad, pixels)
                place = self._views(touched) if len(touched) else _texels(bad)
            raise FloatingPointError(f"the gradient of {name} is NaN, Inf or too large in {_of(bad)} texels ({place})")

    def check_parameters(self) -> None:
        """The parameters after a step, and the light's radiance, which is the exponential of one."""
        for name, parameter in self._parameters.items():
            values = torch.exp(parameter.detach()) if name == "log_light" else parameter.detach()
            if bool(torch.isfinite(values.sum())):  # looking at every texel takes ten times as long
                continue
            bad = ~torch.isfinite(values).all(-1)
            if bool(bad.any()):
                shown = "the light's radiance" if name == "log_light" else name
                raise FloatingPointError(f"{shown} became NaN or Inf in {_of(bad)} texels ({_texels(bad)})")

    def _pixels_that_fetch(self, bad: Tensor, pixels: Tensor) -> Tensor:
        """Those of G-buffer entries (B,) one of whose points looks up a texel of ``bad`` (T, T)."""
        gbuffer = self._problem.gbuffer
        face = gbuffer.face[pixels]
        uv = self._problem.renderer.surface.uv(face.clamp_min(0).long(), gbuffer.barycentric[pixels])
        index, _ = bilinear_taps(uv, *bad.shape)
        return pixels[(bad.reshape(-1)[index].any(-1) & (face >= 0)).any(1)]

    def _views(self, pixels: Tensor) -> str:
        """Names of the views, and rows and columns, of the first few of G-buffer entries."""
        gbuffer = self._problem.gbuffer
        _, height, width = gbuffer.shape
        places = []
        for flat in gbuffer.pixel[pixels].unique().tolist():
            view, row, column = flat // (height * width), flat // width % height, flat % width
            places.append(f"view {self._problem.scene.train[view].name} row {row} column {column}")
        return _few(places)


def _of(bad: Tensor) -> str:
    return f"{int(bad.sum())} of {bad.numel()}"


def _texels(bad: Tensor) -> str:
    return _few([f"row {row} column {column}" for row, column in torch.nonzero(bad).tolist()])


def _few(places: list[str]) -> str:
    more = len(places) - NAMED
    return "; ".join(places[:NAMED]) + (f"; {more} more" if more > 0 else "")
