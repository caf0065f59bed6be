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

    ``guards``: how often a guard (a clamp, a cut step, a refusal) was taken, None where the case has none. ``finite``: whether
    every value and gradient was.
    """

    error: float
    gradient_error: float | None = None
    guards: int | None = None
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


@dataclass(frozen=True)
class Row:
    """A case and what came out; ``problem`` says why it failed, None where it passed."""

    case: Case
    measured: Measured | None
    problem: str | None


def judge(case: Case) -> Row:
    """Run a case. Nothing that it raises gets out."""
    try:
        measured = case.measure()
    except Exception as error:  # the table must be complete whatever one case does
        return Row(case, None, f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no message'}")
    if not measured.finite:
        return Row(case, measured, "NaN or Inf")
    if not measured.error <= case.tolerance:
        return Row(case, measured, f"error above {case.tolerance:g}")
    if measured.gradient_error is not None and not measured.gradient_error <= case.gradient_tolerance:
        return Row(case, measured, f"gradient error above {case.gradient_tolerance:g}")
    return Row(case, measured, None)


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
        return Measured(0.0 if words in str(raised) else math.inf, guards=1)
    return Measured(math.inf, guards=0)
