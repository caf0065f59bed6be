"""One extreme case: what is measured, what the answer is compared with, and how far off it may be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Measured:
    """``error`` against the reference of the case, ``gradient_error`` against that of the gradient (None: not asked).

    ``finite``: whether every value and gradient was.
    """

    error: float
    gradient_error: float | None = None
    finite: bool = True


@dataclass(frozen=True)
class Case:
    """``extreme``: what is extreme about the input; ``quantity``: what is computed; ``reference``: what it is compared with.

    ``tolerance`` bounds the error and ``gradient_tolerance`` the gradient's; both are relative unless the quantity says
    otherwise. ``measure`` may raise: a case that does has failed.
    """

    group: str
    extreme: str
    quantity: str
    reference: str
    tolerance: float
    measure: Callable[[], Measured]
    gradient_tolerance: float = math.inf


def judge(case: Case) -> str | None:
    """Run a case: why it failed, None where it passed."""
    measured = case.measure()
    if not measured.finite:
        return "NaN or Inf"
    if not measured.error <= case.tolerance:
        return f"error {measured.error:.2e} above {case.tolerance:g}"
    if measured.gradient_error is not None and not measured.gradient_error <= case.gradient_tolerance:
        return f"gradient error {measured.gradient_error:.2e} above {case.gradient_tolerance:g}"
    return None


def deviation(found: Tensor, reference: Tensor, floor: float = 0.0) -> float:
    """Largest |found - reference| / (|reference| + ``floor``); 0 for 0 / 0, NaN where ``found`` is."""
    difference = (found.double() - reference.double()).abs()
    scale = reference.double().abs() + floor
    return float(torch.where(difference == 0, 0.0, difference / scale).max())


def all_finite(*tensors: Tensor) -> bool:
    """Whether every value is."""
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


def refused(action: Callable[[], object], error: type[Exception], words: str) -> Measured:
    """The measurement of a case that must raise ``error`` with ``words`` in its message: 0 if it does, else infinite."""
    try:
        action()
    except error as raised:
        return Measured(0.0 if words in str(raised) else math.inf)
    return Measured(math.inf)
