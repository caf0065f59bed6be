"""What a network saw reduced, brought back to the size of the image without losing what is known there.

Enlarging an albedo would blur it: on the development scenes even the truth has only 23 to 25 dB after a way through 64 x 64
and back. So what is enlarged is the smooth part, as in joint upsampling (Kopf et al. 2007).

The functions take display values in [0, 1]: the prediction ``reduced`` (S, S, 3); what it is compared with, as the network
saw it (``seen``, (S, S, 3)) and at its own size (``image`` or ``render``, (H, W, 3)); and where the prediction counts
(``known``, (S, S)).
"""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.priors.diffusion.framing import Frame

FLOOR = 0.03
"""Display value added to both sides of a gain, so that black pixels of an image allow any albedo."""


def enlarge(frame: Frame, reduced: Tensor, known: Tensor, shape: torch.Size) -> Tensor:
    """Enlarge ``reduced`` smoothly, for specular shading, whose highlights are no texture of the image."""
    return frame.paste(reduced, known, torch.ones(shape))


def enlarge_by_gain(frame: Frame, reduced: Tensor, seen: Tensor, image: Tensor, known: Tensor) -> Tensor:
    """Multiply ``image`` by the enlarged ratio of an albedo to the image as the network saw it.

    The ratio is the inverse of shading and as smooth as that is, while texture is the image's own.
    """
    if frame.length == frame.side:
        return enlarge(frame, reduced, known, image.shape[:2])
    gain = enlarge(frame, (reduced + FLOOR) / (seen + FLOOR), known, image.shape[:2])
    return ((image + FLOOR) * gain - FLOOR).clamp(0, 1)


def enlarge_by_difference(frame: Frame, reduced: Tensor, seen: Tensor, render: Tensor, known: Tensor) -> Tensor:
    """Add to ``render`` the enlarged difference between the prediction and the render as the network saw it.

    It serves what was guided by the render or denoised from it: where the network changes nothing, nothing changes.
    """
    if frame.length == frame.side:
        return enlarge(frame, reduced, known, render.shape[:2])
    change = 2 * enlarge(frame, (1 + reduced - seen) / 2, known, render.shape[:2]) - 1  # frames paste nothing below zero
    return (render + change).clamp(0, 1)
