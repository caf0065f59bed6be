"""Cutting the object out of an image into the square that a network sees, and putting predictions back.

Enlarging an albedo would blur it: on the development scenes even the truth has only 23 to 25 dB after a way through 64 x 64
and back. So what is enlarged is the smooth part, as in joint upsampling (Kopf et al. 2007). The functions for this take display
values in [0, 1]: the prediction ``reduced`` (S, S, 3); what it is compared with, as the network saw it (``seen``, (S, S, 3)) and
at its own size (``image`` or ``render``, (H, W, 3)); and where the prediction counts (``known``, (S, S)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

MARGIN = 0.03
"""Margin on each side of the box around the object, as a share of its side: training images leave about as much."""
MULTIPLE = 8
"""Pixels of which the side of a frame at full resolution is a multiple, so that views of nearly one size make one batch."""

FLOOR = 0.03
"""Display value added to both sides of a gain, so that black pixels of an image allow any albedo."""


@dataclass(frozen=True)
class Frame:
    """A square of the image, and the size that it is resized to, all in pixels.

    Attributes:
        top: Row of its upper edge, which may be negative.
        left: Column of its left edge, which may be negative.
        length: Its side in the image.
        side: Its side after resizing.
    """

    top: int
    left: int
    length: int
    side: int

    @classmethod
    def around(cls, mask: Tensor, side: int | None) -> Frame | None:
        """The square around the foreground of ``mask`` (H, W); None where nothing is covered.

        It is resized to ``side``, or for None left as it is, with its length a multiple of MULTIPLE.
        """
        covered = mask > 0
        if not bool(covered.any()):
            return None
        rows, columns = (torch.nonzero(covered.any(axis))[:, 0] for axis in (1, 0))
        ends = [(int(found[0]), int(found[-1]) + 1) for found in (rows, columns)]
        length = math.ceil(max(stop - start for start, stop in ends) * (1 + 2 * MARGIN))
        if side is None:
            length = math.ceil(length / MULTIPLE) * MULTIPLE
        top, left = ((start + stop - length) // 2 for start, stop in ends)
        return cls(top, left, length, length if side is None else side)

    def cut(self, values: Tensor) -> Tensor:
        """Cut premultiplied values (H, W, C) out: (side, side, C). What lies outside the image is zero."""
        height, width, _ = values.shape
        rows, columns = self._inside(height, width)
        square = values.new_zeros(self.length, self.length, values.shape[-1])
        square[rows.start - self.top : rows.stop - self.top, columns.start - self.left : columns.stop - self.left] = values[
            rows, columns
        ]
        return _resize(square, self.side)

    def paste(self, values: Tensor, weight: Tensor, mask: Tensor) -> Tensor:
        """Put straight values (side, side, C) back into the image: (H, W, C), times ``mask``.

        They are known where ``weight`` (side, side) > 0; a pixel near the edge averages only what is known.
        """
        known = torch.cat([values * weight[..., None], weight[..., None]], -1)
        known = _resize(known, self.length).clamp_min(0)
        straight = known[..., :-1] / known[..., -1:].clamp_min(1e-4)
        rows, columns = self._inside(*mask.shape)
        image = values.new_zeros(*mask.shape, values.shape[-1])
        image[rows, columns] = straight[
            rows.start - self.top : rows.stop - self.top, columns.start - self.left : columns.stop - self.left
        ]
        return image * mask[..., None]

    def _inside(self, height: int, width: int) -> tuple[slice, slice]:
        rows = slice(max(self.top, 0), min(self.top + self.length, height))
        return rows, slice(max(self.left, 0), min(self.left + self.length, width))


def _resize(square: Tensor, side: int) -> Tensor:
    if square.shape[0] == side:
        return square
    moved = square.movedim(-1, 0)[None]
    return F.interpolate(moved, (side, side), mode="bilinear", antialias=True, align_corners=False)[0].movedim(0, -1)


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
