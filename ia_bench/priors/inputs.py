"""What priors with networks ask of their callers, and how a view is told from another: shared by all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from ia_bench.common.errors import InputError


def choose_device(wanted: str) -> torch.device:
    """The device of the option ``device``: auto takes CUDA where torch finds it. Raises InputError."""
    if wanted not in ("auto", "cpu", "cuda"):
        raise InputError(f"prior.options.device: expected auto, cpu or cuda, found {wanted}")
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise InputError("prior.options.device=cuda: torch finds no CUDA device here; use cpu or auto")
    return torch.device("cuda" if available and wanted != "cpu" else "cpu")


def check_views(name: str, images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], provided: Iterable[str]) -> None:
    """Raise InputError unless ``images`` (V, H, W, 3), ``masks`` (V, H, W) and ``renders`` can be worked with.

    ``renders``: what is to guide the sample, by component, each of the images' shape and ``provided`` by the prior ``name``.
    """
    if images.ndim != 4 or images.shape[-1] != 3:
        raise InputError(f"prior={name}: expected images of shape (V, H, W, 3), found {tuple(images.shape)}")
    if tuple(masks.shape) != tuple(images.shape[:3]):
        raise InputError(f"prior={name}: expected masks of shape {tuple(images.shape[:3])}, found {tuple(masks.shape)}")
    known = sorted(provided)
    for component, render in renders.items():
        if component not in known:
            raise InputError(f"prior={name}: guidance: expected some of {', '.join(known)}, found {component}")
        if render.shape != images.shape:
            raise InputError(
                f"prior={name}: expected guidance {component} of shape {tuple(images.shape)}, found {tuple(render.shape)}"
            )
    guidance = {f"guidance {component}": render for component, render in renders.items()}
    for what, values in {"images": images, "masks": masks, **guidance}.items():
        if not bool(torch.isfinite(values).all()):
            raise InputError(f"prior={name}: expected finite {what}, found NaN or Inf")


def content_number(image: Tensor, mask: Tensor) -> int:
    """A number of 56 bits that stands for the content of an image (H, W, 3) and its mask: seeds a view's own noise."""
    digest = hashlib.sha256(image.float().contiguous().numpy().tobytes() + mask.float().contiguous().numpy().tobytes())
    return int.from_bytes(digest.digest()[:7], "little")
