"""Colour profiles (ICC) that photographs carry: colours of other primaries or another tone curve, turned into sRGB."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms

from ia_bench.common.files import shown

CONVERTED = ("RGB", "RGBA", "P")
"""Modes of Pillow whose colours a profile is applied to: 8 bits of red, green and blue."""

ROUNDING = 2  # steps of 255 by which a profile of sRGB itself may move a colour
IGNORED = "is ignored, and sRGB assumed"


def in_srgb(path: Path, picture: Image.Image, notice: Callable[[str], None]) -> Image.Image:
    """The ``picture`` with the colours that its profile describes, in sRGB, and its alpha; what sRGB cannot hold is clipped.

    A picture without a profile, or with one of sRGB, is returned as it is. So is one with a profile that cannot be applied (more
    than 8 bits, grey, CMYK, damaged), of which ``notice`` is told.
    """
    content = picture.info.get("icc_profile")
    if not content:
        return picture
    name, transform = _transform(content)
    if transform is not None and not _moves_colours(transform):
        return picture
    if transform is None or picture.mode not in CONVERTED:
        notice(f"{path}: its colour profile {name} {IGNORED}")
        return picture
    straight = picture.convert("RGBA")
    turned = transform.apply(straight.convert("RGB"))
    turned.putalpha(straight.getchannel("A"))
    return turned


def _transform(content: bytes) -> tuple[str, ImageCms.ImageCmsTransform | None]:
    """A profile's name, and what turns its colours into sRGB: None where it is not one of red, green and blue, or damaged."""
    name = "(damaged)"
    try:
        profile = ImageCms.ImageCmsProfile(BytesIO(content))
        name = shown(ImageCms.getProfileDescription(profile).strip())
        srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
        return name, ImageCms.ImageCmsTransform(profile, srgb, "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
    except (OSError, ImageCms.PyCMSError):
        return name, None


def _moves_colours(transform: ImageCms.ImageCmsTransform) -> bool:
    """Whether colours change by more than rounding; names of profiles do not tell, as there is a "linear sRGB", too."""
    levels = np.linspace(0, 255, 6).astype(np.uint8)
    probe = np.stack(np.meshgrid(levels, levels, levels), -1).reshape(6, 36, 3)
    turned = np.asarray(transform.apply(Image.fromarray(probe)))
    return bool(np.abs(turned.astype(int) - probe.astype(int)).max() > ROUNDING)
