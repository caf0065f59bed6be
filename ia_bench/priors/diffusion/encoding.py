"""Between linear images and the space in which the networks work: display-encoded, [-1, 1], channels first.

An image has an unknown exposure. It is divided out before anything is encoded: a photograph and a render of the same
object then look the same to the network, and the specular shading, which scales with the image, is predicted relative
to it. The albedo does not scale.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.images import straight

EXPOSED_QUANTILE = 0.9
"""This share of the foreground is darker (in its brightest channel) than EXPOSED_VALUE after exposure."""
EXPOSED_VALUE = 0.7
"""Linear; leaves half a stop to highlights before an image clips, as a camera's automatic exposure does."""
FAINTEST = 1e-3
"""A coverage below it counts as it: what so faint a pixel shows is rounding."""


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
    usable = (count > 0) & (level > 1e-8)
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
