"""Pixels whose radiance is known from below only: a saturated sensor, an unknown value (see ``View.valid``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.scenes.scene import View


def known_pixels(views: Sequence[View]) -> Tensor | None:
    """``valid`` of views of one size, (V, H, W, 1) bool; None where every pixel of all of them is known."""
    if all(view.valid is None for view in views):
        return None
    known = [view.known for view in views]
    return torch.from_numpy(np.stack(known))[..., None]


def one_sided(target: Tensor, rendered: Tensor, known: Tensor | None) -> Tensor:
    """What a loss compares ``rendered`` (N, 3) with: ``target`` (N, 3), or the render itself where it may be that bright.

    Where ``known`` (N, 1) is False, the target is a lower bound: a brighter render equals what it is compared with, so that any
    loss of their difference is at its least there and has no gradient.
    """
    return target if known is None else torch.where(known, target, torch.maximum(target, rendered.detach()))
