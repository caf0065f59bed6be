"""From a linear image and its mask to what the release's networks were trained on, and back.

They saw the object alone, cut out along its mask, white around it, scaled to fill a square, in gamma 2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt
from torch import Tensor

GAMMA = 2.2
COVERED = 0.5
"""A pixel belongs to the object where more than this much of it is covered."""


@dataclass(frozen=True)
class Crop:
    """The object's bounding box in the image, and the box that it fills in the square (pixels; both half open)."""

    rows: slice
    columns: slice
    square_rows: slice
    square_columns: slice

    @classmethod
    def of(cls, mask: Tensor, side: int) -> Crop | None:
        """The crop of ``mask`` (H, W) for a square of ``side`` pixels; None where no pixel belongs to the object.

        The longer side of the box fills the square, the shorter one is centred, to whole pixels.
        """
        hits = [(mask > COVERED).any(axis).nonzero() for axis in (1, 0)]
        if not len(hits[0]):
            return None
        boxes = [slice(int(hit[0]), int(hit[-1]) + 1) for hit in hits]
        longest = max(box.stop - box.start for box in boxes)
        lengths = [max(round((box.stop - box.start) * side / longest), 1) for box in boxes]
        starts = [round((side - length) / 2) for length in lengths]
        return cls(*boxes, *(slice(start, start + length) for start, length in zip(starts, lengths, strict=True)))


def encode(image: Tensor, mask: Tensor, crop: Crop, side: int) -> Tensor:
    """(3, side, side) in [0, 1], gamma 2.2, of ``image`` (H, W, 3), linear and premultiplied by ``mask`` (H, W).

    Radiance above 1 is clipped, as in the 8-bit photographs that the networks know.
    """
    colour = (image / mask.clamp(min=COVERED)[..., None]).clamp(0, 1) ** (1 / GAMMA)
    cut = torch.where((mask > COVERED)[..., None], colour, 1.0)[crop.rows, crop.columns]
    square = cut.new_ones(3, side, side)
    place = square[:, crop.square_rows, crop.square_columns]
    place[:] = _resize(cut.movedim(-1, 0), (place.shape[1], place.shape[2]))
    return square


def decode(square: Tensor, mask: Tensor, crop: Crop) -> Tensor:
    """The inverse of :func:`encode`: (H, W, 3) float32, linear, premultiplied by ``mask``.

    A pixel that is covered by half or less, white to the network, takes the colour of the nearest one that is covered more.
    """
    cut = square[:, crop.square_rows, crop.square_columns].float().cpu()
    size = crop.rows.stop - crop.rows.start, crop.columns.stop - crop.columns.start
    image = mask.new_zeros(*mask.shape, 3, dtype=torch.float32)
    image[crop.rows, crop.columns] = _resize(cut, size).movedim(0, -1) ** GAMMA
    row, column = distance_transform_edt((mask <= COVERED).numpy(), return_distances=False, return_indices=True)
    return image[torch.from_numpy(row).long(), torch.from_numpy(column).long()] * mask[..., None]


def _resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    """(3, h, w) by bilinear interpolation, with a filter as wide as a target pixel where it shrinks."""
    return F.interpolate(image[None], size, mode="bilinear", antialias=True)[0].clamp(0, 1)
