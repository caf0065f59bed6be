"""What priors with networks ask of their callers, and how a view is told from another: shared by all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations

Device = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "bf16", "float32"]


_run_device: ContextVar[str | None] = ContextVar("run_device", default=None)


@contextmanager
def beside_run(device: str) -> Iterator[None]:
    """Priors that are made inside belong to a run on ``device``, "cpu" or "cuda".

    One of a run on the CPU stays there unless its own options say otherwise: the same configuration is to give the same numbers on
    a machine that has a GPU.
    """
    token = _run_device.set(device)
    try:
        yield
    finally:
        _run_device.reset(token)


def choose_device(wanted: Device) -> torch.device:
    """The device of the option ``device``: auto takes CUDA where torch finds it, but not in a run on the CPU. Raises InputError."""
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise InputError("prior.options.device=cuda: torch finds no CUDA device here; use cpu or auto")
    if wanted == "auto" and _run_device.get() == "cpu":
        return torch.device("cpu")
    return torch.device("cuda" if available and wanted != "cpu" else "cpu")


def use_bf16(precision: Precision, device: torch.device) -> bool:
    """Whether networks compute in bfloat16: twice as fast where the processor has it, at 8 bits of mantissa.

    "auto" takes it where it is fast.
    """
    if precision != "auto":
        return precision == "bf16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    supported: bool = torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return supported and torch.backends.cpu.get_cpu_capability() == "AVX512"


def expect_usable(
    name: str,
    observations: Observations,
    renders: Mapping[str, Tensor],
    provided: Iterable[str],
    channels: Mapping[str, int] = {},
    *,
    what: str = "guidance",
) -> None:
    """Raise InputError unless the prior ``name`` can work with the observations and ``renders``.

    ``renders``: what is to guide the sample, to be distilled or corrected, by component, each ``provided`` by the prior and of the
    images' shape, with as many ``channels`` as are said, else 3. ``what``: the word for it.
    """
    images, masks, seen = observations.images, observations.masks, tuple(observations.images.shape[:3])
    if images.ndim != 4 or images.shape[-1] != 3:
        raise InputError(f"prior={name}: expected images of shape (V, H, W, 3), found {tuple(images.shape)}")
    unknown = [component for component in renders if component not in set(provided)]
    if unknown:
        raise InputError(f"prior={name}: {what}: expected some of {', '.join(sorted(provided))}, found {unknown[0]}")
    expected = {
        "masks": (masks, seen),
        **{f"{what} {name}": (render, (*seen, channels.get(name, 3))) for name, render in renders.items()},
        "normals": (observations.normals, (*seen, 3)),
        "visibility": (observations.visibility, (*seen, 1)),
        "view_count": (observations.view_count, (*seen, 1)),
    }
    for tensor, (values, shape) in {"images": (images, (*seen, 3)), **expected}.items():
        if values is not None and tuple(values.shape) != shape:
            raise InputError(f"prior={name}: expected {tensor} of shape {shape}, found {tuple(values.shape)}")
        if values is not None and not bool(torch.isfinite(values).all()):
            raise InputError(f"prior={name}: expected finite {tensor}, found NaN or Inf")


def check_truth(name: str, observations: Observations, components: Iterable[str]) -> None:
    """Raise InputError unless the observations tell the prior ``name`` the truth of ``components``."""
    for component in sorted(components):
        truth = (observations.truth or {}).get(component)
        found = "none" if truth is None else f"shape {tuple(truth.shape)}"
        if truth is None or truth.shape != observations.images.shape:
            shape = tuple(observations.images.shape)
            raise InputError(f"prior={name}: expected the true {component} of images of shape {shape}, found {found}")


def content_number(image: Tensor, mask: Tensor) -> int:
    """A number of 56 bits that stands for the content of an image (H, W, 3) and its mask: seeds a view's own noise."""
    digest = hashlib.sha256(image.float().contiguous().numpy().tobytes() + mask.float().contiguous().numpy().tobytes())
    return int.from_bytes(digest.digest()[:7], "little")
