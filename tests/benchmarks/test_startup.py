"""The phases of a start by the functions that they are found by."""

from __future__ import annotations

from functools import reduce
from importlib import import_module

import pytest

from benchmarks.startup import PHASES


@pytest.mark.parametrize("place", PHASES)
def test_the_function_of_a_phase_is_there(place: str) -> None:
    module, _, function = place.partition(":")
    assert callable(reduce(getattr, function.split("."), import_module(module)))
