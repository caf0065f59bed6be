"""What makes training fast on this machine: a C++ compiler for torch, a processor with products of bfloat16."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Literal

import torch

from ia_bench.priors.inputs import Precision, use_bf16


def compiles(asked: bool | Literal["auto"], what: str, notice: Callable[[str], None]) -> bool:
    """Resolve a setting: "auto" is yes where a C++ compiler is found, and else says so in one line that names ``what``."""
    if asked != "auto":
        return asked
    found = bool(shutil.which("g++") or shutil.which("clang++"))
    if not found:
        notice(f"{what} is not compiled, and slower: no C++ compiler found for torch.compile")
    return found


def trains_in_bf16(precision: Precision, device: torch.device) -> bool:
    """Resolve a setting: "auto" takes bfloat16 where it is twice as fast, on processors, too; weights need not repeat.

    Processors with AVX-512 but no products of bfloat16 take 3.5 times as long with it as without.
    """
    if precision != "auto" or device.type == "cuda":
        return use_bf16(precision, device)
    return torch.cpu._is_avx512_bf16_supported()
