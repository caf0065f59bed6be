"""Between linear images and the space in which the networks work: display-encoded, [-1, 1], channels first.

An image has an unknown exposure. It is divided out before anything is encoded: a photograph and a render of the same
object then look the same to the network, and the specular shading, which scales with the image, is predicted relative
to it. The albedo does not scale.

The object is cut out of an image into the square that a network sees, and predictions are put back.
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

from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.images import straight

EXPOSED_QUANTILE = 0.9
"""This share of the foreground is darker (in its brightest channel) than EXPOSED_VALUE after exposure."""
EXPOSED_VALUE = 0.7
"""Linear; leaves half a stop to highlights before an image clips, as a camera's automatic exposure does."""
FAINTEST = 1e-3  # a coverage below it counts as it: what so faint a pixel shows is rounding
DARKEST = 1e-30  # a radiance, in any unit, below which there is no light
FAINT = 0.01  # of the largest coverage: less of it is haze
MARGIN = 0.03
"""Margin on each side of the box around the object, as a share of its side: training images leave about as much."""
MULTIPLE = 8
"""Pixels of which the side of a frame at full resolution is a multiple, so that views of nearly one size make one batch."""
FLOOR = 0.03  # display value added to both sides of a gain, so that black pixels of an image allow any albedo


def exposure(images: Tensor, masks: Tensor) -> Tensor:
    """The factor (N,) that brings each image (N, H, W, 3), premultiplied by ``masks`` (N, H, W), to the exposure above.

    An image's largest coverage counts as a whole one, because glass has an exposure too. The factor is 1 for an image
    without foreground or light.
    """
    coverage = masks.flatten(1)
    full = coverage.amax(1, keepdim=True).clamp_min(1e-3)
    brightest = images.amax(-1).flatten(1) / full
    inside = coverage > 0.5 * full
    ordered = torch.where(inside, brightest, torch.inf).sort(1).values
    count = inside.sum(1)
    rank = (EXPOSED_QUANTILE * (count - 1)).round().long().clamp_min(0)
    level = ordered.gather(1, rank[:, None])[:, 0]
    usable = (count > 0) & (level > DARKEST)
    return torch.where(usable, EXPOSED_VALUE / torch.where(usable, level, 1.0), 1.0)


def encode_image(images: Tensor, masks: Tensor, factor: Tensor) -> Tensor:
    """The condition (N, 4, H, W): exposed colour as on a display, clipped at white, in [-1, 1], and the mask in [0, 1]."""
    colour = _encode(straight(images, masks, FAINTEST) * factor[:, None, None, None], masks)
    return torch.cat([colour, masks[:, None]], 1)


def encode(component: str, linear: Tensor, masks: Tensor, factor: Tensor) -> Tensor:
    """Linear images (N, H, W, 3) of ``component``, premultiplied, as (N, 3, H, W) in [-1, 1]; 0 outside the mask.

    Specular shading is exposed like its image and clipped at the image's white, as the paper's training data was.
    """
    colour = straight(linear, masks, FAINTEST)
    return _encode(colour if component == "albedo" else colour * factor[:, None, None, None], masks)


def decode(component: str, encoded: Tensor, masks: Tensor, factor: Tensor) -> Tensor:
    """The inverse of :func:`encode`: linear, in [0, 1] or in the units of the image, premultiplied by the masks."""
    colour = srgb_to_linear((0.5 + 0.5 * encoded.movedim(1, -1)).clamp(0, 1))
    return (colour if component == "albedo" else colour / factor[:, None, None, None]) * masks[..., None]


def encode_geometry(normals: Tensor, visibility: Tensor) -> Tensor:
    """Camera-space normals (N, H, W, 3) and ambient visibility (N, H, W, 1), premultiplied, as (N, 4, H, W)."""
    return torch.cat([normals, visibility], -1).movedim(-1, 1)


def _encode(colour: Tensor, masks: Tensor) -> Tensor:
    encoded = 2 * linear_to_srgb(colour.clamp(0, 1)) - 1
    return torch.where(masks[..., None] > 0, encoded, torch.zeros_like(encoded)).movedim(-1, 1)


# ---- frames -----------------------------------------------------------------------------------------------------------


def box_of(inside: Tensor) -> tuple[slice, slice] | None:
    """Rows and columns of the smallest box that holds what is true in (H, W); None where nothing is."""
    rows, columns = (torch.nonzero(inside.any(axis))[:, 0].tolist() for axis in (1, 0))
    return (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if rows else None


@dataclass(frozen=True)
class Frame:
    """A square of the image, and the size that it is resized to, all in pixels.

    ``top`` and ``left`` are its first row and column, which may be negative; ``length`` is its side in the image, ``side`` that
    after resizing.
    """

    top: int
    left: int
    length: int
    side: int

    @classmethod
    def around(cls, mask: Tensor, side: int | None, margin: float = MARGIN) -> Frame | None:
        """The square around the foreground of ``mask`` (H, W), with a ``margin``; None where nothing is covered.

        Coverage of no more than FAINT times the largest, the haze of a matting tool or of JPEG, is no foreground. The square is
        resized to ``side``, or for None left as it is, with its length a multiple of MULTIPLE.
        """
        box = box_of(mask > FAINT * mask.max())
        if box is None:
            return None
        length = math.ceil(max(part.stop - part.start for part in box) * (1 + 2 * margin))
        if side is None:
            length = math.ceil(length / MULTIPLE) * MULTIPLE
        top, left = ((part.start + part.stop - length) // 2 for part in box)
        return cls(top, left, length, length if side is None else side)

    def cut(self, values: Tensor) -> Tensor:
        """Cut premultiplied values (H, W, C) out: (side, side, C). What lies outside the image is zero."""
        return resized(window(values, self.left, self.top, self.length, self.length), self.side, self.side)

    def paste(self, values: Tensor, weight: Tensor, mask: Tensor) -> Tensor:
        """Put straight values (side, side, C) back into the image: (H, W, C), times ``mask``.

        They are known where ``weight`` (side, side) > 0; a pixel near the edge averages only what is known.
        """
        known = torch.cat([values * weight[..., None], weight[..., None]], -1)
        known = resized(known, self.length, self.length).clamp_min(0)
        straight = known[..., :-1] / known[..., -1:].clamp_min(1e-4)
        height, width = mask.shape
        return window(straight, -self.left, -self.top, width, height) * mask[..., None]


def window(values: Tensor, left: int, top: int, width: int, height: int) -> Tensor:
    """The part of (H, W, C) that begins at a column and a row, 0 where that lies beyond the edges; the two must overlap."""
    return F.pad(values, (0, 0, -left, left + width - values.shape[1], -top, top + height - values.shape[0]))


def resized(values: Tensor, height: int, width: int) -> Tensor:
    """Premultiplied values (H, W, C) with as many pixels; to the bit where there are as many already."""
    if values.shape[:2] == (height, width):
        return values
    moved = values.movedim(-1, 0)[None]
    return F.interpolate(moved, (height, width), mode="bilinear", antialias=True, align_corners=False)[0].movedim(0, -1)


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
