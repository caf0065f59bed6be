"""Where and how precisely the networks of priors compute, and how a view is told from another: shared by all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal

import torch
from torch import Tensor

from ia_bench.common.errors import InputError

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
    """Whether networks compute in bfloat16, at 8 bits of mantissa; "auto" does so on a GPU alone.

    Processors sum such products each in its own way: samples of one seed differ by up to .008 between them, in float32 by 1e-6.
    """
    return precision == "bf16" or (precision == "auto" and device.type == "cuda" and torch.cuda.is_bf16_supported())


def content_number(image: Tensor, mask: Tensor) -> int:
    """A number of 56 bits that stands for what an image (H, W, 3) shows where its mask is not 0: seeds a view's own noise.

    What is around that does not count, so that a photograph has the same noise beside larger ones, to whose size it is padded.
    """
    rows, columns = (mask.amax(axis) > 0 for axis in (1, 0))
    shown = (part.float()[rows][:, columns].contiguous() for part in (image, mask))
    digest = hashlib.sha256(b"".join(part.numpy().tobytes() for part in shown))
    return int.from_bytes(digest.digest()[:7], "little")
