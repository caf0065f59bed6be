"""Whether networks run in bfloat16: twice as fast where the processor has it, at 8 bits of mantissa."""

from __future__ import annotations

import torch

from ia_bench.common.errors import InputError
from ia_bench.common.suggestions import unknown

PRECISIONS = ("auto", "bf16", "float32")


def use_bf16(precision: str, device: torch.device, key: str) -> bool:
    """Tell whether ``precision`` means bfloat16 on ``device``; "auto" takes it where it is fast. InputError names ``key``."""
    if precision not in PRECISIONS:
        raise InputError(unknown(f"value of {key}", precision, PRECISIONS))
    if precision != "auto":
        return precision == "bf16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    supported: bool = torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return supported and torch.backends.cpu.get_cpu_capability() == "AVX512"
