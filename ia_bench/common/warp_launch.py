"""Warp kernels over torch tensors: on CUDA as they are, on the CPU one range of their items per thread of torch."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
import warp as wp
from torch import Tensor

from ia_bench.common.cache import tell_once

LEAST_ITEMS = 256  # of a range: fewer are not worth a thread
_pool = ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="kernels")  # more than 32 where there are


def _begin() -> None:
    """Load Warp without a word: of every module that it loads, and, from below Python, of a GPU that is not there.

    Where it cannot keep compiled kernels (no home folder, or one that is read-only), this process compiles its own.
    """
    wp.config.log_level = wp.LOG_ERROR
    shown, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    why = ""
    try:
        os.dup2(nowhere, 2)
        try:
            wp.init()
        except OSError as error:
            why = error.strerror or str(error)
        folder = wp.config.kernel_cache_dir
        if why or not os.access(folder, os.W_OK):
            wp.config.kernel_cache_dir = tempfile.mkdtemp(prefix="ia_bench-kernels-")
            atexit.register(shutil.rmtree, wp.config.kernel_cache_dir, ignore_errors=True)
            wp.init()
            why = why or "it cannot be written"
    finally:
        os.dup2(shown, 2)
        os.close(shown)
        os.close(nowhere)
    if why:
        tell_once(f"{folder}: no kernels can be kept there ({why}); set WARP_CACHE_PATH to a folder that can be written")


_begin()


def launch(
    kernel: wp.Kernel, count: int, *arguments: object, device: torch.device, lanes: int = 1, sums: Sequence[Tensor | None] = ()
) -> None:
    """Run ``kernel`` for ``count`` items, ``lanes`` of them at a time; it reads and writes tensors among ``arguments`` in place.

    A kernel's first parameter is the number of the first item of its range, which is given here. Tensors have to be
    of the kernel's own types (a ``vec3`` is a last axis of 3, for instance), and contiguous where C++ of our own reads them.

    Its last parameters are ``sums``, to which any item may add anywhere. Sums into one place by two threads would be lost, so every
    range but the first has some of its own, which are added at the end. None stands for a sum that the kernel leaves alone.
    """
    count = -(-count // lanes)
    share = max(LEAST_ITEMS // lanes, -(-count // (torch.get_num_threads() if device.type == "cpu" else 1)))
    starts = range(0, count, share)
    own = [[s if first == 0 or s is None else torch.zeros_like(s) for s in sums] for first in starts]
    shared = _values(kernel, 1, arguments, device)  # once: threads that prepare the same would wait for each other

    def run(first: int, into: Sequence[Tensor | None]) -> None:
        values = [first, *shared, *_values(kernel, 1 + len(arguments), into, device)]
        wp.launch(kernel, min(share, count - first), values, device=str(device))

    others = [_pool.submit(run, *given) for given in zip(starts[1:], own[1:], strict=True)]
    for given in zip(starts[:1], own, strict=False):  # the first in this thread
        run(*given)
    for other in others:
        other.result()
    for more in own[1:]:
        for total, part in zip(own[0], more, strict=True):
            if total is not None and part is not None:
                total += part


def _values(kernel: wp.Kernel, place: int, arguments: Sequence[object], device: torch.device) -> list[Any]:
    """The arguments from ``place`` on as Warp takes them; None stands for an array of nothing."""
    values = []
    for value, argument in zip(arguments, kernel.adj.args[place : place + len(arguments)], strict=True):
        if isinstance(value, Tensor):
            if value.device.type != device.type:  # Warp would follow an address that means nothing there
                raise ValueError(f"{kernel.key}({argument.label}): expected a tensor on {device.type}, found one on {value.device}")
            value = wp.from_torch(value.detach(), dtype=argument.type.dtype, return_ctype=True)
            if value.ndim != argument.type.ndim:  # Warp would read beyond the end
                raise ValueError(f"{kernel.key}({argument.label}): expected {argument.type.ndim} axes, found {value.ndim}")
        values.append(value)
    return values
