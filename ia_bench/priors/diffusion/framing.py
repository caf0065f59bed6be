"""Cutting the object out of an image into the square that a network sees, and putting predictions back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

MARGIN = 0.03
"""Of the box around the object, on each side: training images leave about as much."""
MULTIPLE = 8
"""Pixels of which the side of a frame at full resolution is a multiple, so that views of nearly one size make one batch."""


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
