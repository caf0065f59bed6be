"""Whether a state could have been written by the fit that is to go on from it."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class Some(dict[Any, Any]):
    """The form of a dict that may lack any of these keys."""


def check_form(found: Any, form: Any, where: str = "state") -> None:  # noqa: ANN401 (whatever a checkpoint may hold)
    """Raise ValueError, naming the place, unless ``found`` has the form of ``form``.

    A tensor stands for all of its dtype and shape, a number, text or None for all of its type, a type for all dicts from names
    to values of that type. A dict has exactly the keys of its form (see :class:`Some`), a list or tuple its length.
    """
    expected = f"a value of type {type(form).__name__}"
    if isinstance(form, Tensor):
        expected = f"{form.dtype} {tuple(form.shape)}"
        right = isinstance(found, Tensor) and (found.dtype, found.shape) == (form.dtype, form.shape)
    elif isinstance(form, type):
        expected = f"names, each with a value of type {form.__name__}"
        right = isinstance(found, dict) and all(type(part) is form for part in found.values())
    elif isinstance(form, dict):
        expected = ", ".join(map(str, form)) or "nothing"
        known = isinstance(found, dict) and set(found) <= set(form)
        right = known and (isinstance(form, Some) or len(found) == len(form))
        parts = found if right else {}
        for key in parts:
            check_form(found[key], form[key], f"{where}.{key}")
    elif isinstance(form, list | tuple):
        expected = f"{len(form)} items"
        right = isinstance(found, list | tuple) and len(found) == len(form)
        for place, (part, one) in enumerate(zip(found if right else (), form, strict=right)):
            check_form(part, one, f"{where}[{place}]")
    else:
        right = type(found) is type(form)
    if not right:
        raise ValueError(f"{where}: expected {expected}, found {_shown(found)}")


def form_of_adam(optimizer: torch.optim.Optimizer) -> dict[str, Any]:
    """The form of the ``state_dict`` of an Adam: parameters that have not moved yet have no moments."""
    parameters = [p.detach().cpu() for group in optimizer.param_groups for p in group["params"]]
    moments = {index: {"step": torch.zeros(()), "exp_avg": p, "exp_avg_sq": p} for index, p in enumerate(parameters)}
    return {"state": Some(moments), "param_groups": optimizer.state_dict()["param_groups"]}


def _shown(value: Any) -> str:  # noqa: ANN401 (as check_form)
    if isinstance(value, Tensor):
        return f"{value.dtype} {tuple(value.shape)}"
    return (", ".join(map(str, value)) or "nothing") if isinstance(value, dict) else f"{value!r:.50}"
