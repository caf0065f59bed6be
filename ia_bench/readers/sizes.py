"""How much of a dataset is read: smaller images, fewer held-out views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import View

T = TypeVar("T")


def evenly(items: Sequence[T], count: int | None) -> list[T]:
    """``count`` of the ``items``, spread evenly and in their order; those of a smaller count are among those of a larger one.

    They are taken in the order of van der Corput's sequence (each next one halves the largest gap). None takes all.
    """
    if count is None or count >= len(items):
        return list(items)
    bits = max(1, (len(items) - 1).bit_length())
    order = (int(format(number, f"0{bits}b")[::-1], 2) for number in range(2**bits))
    return [items[place] for place in sorted([place for place in order if place < len(items)][:count])]


def shrunk(view: View, block: int) -> View:
    """The view in blocks of pixels (:meth:`View.scaled`). Raises InputError where there are none."""
    smaller = min(view.camera.height, view.camera.width)
    if block > smaller:
        raise InputError(f"reader.options.shrink: expected at most {smaller}, found {block}")
    return view.scaled(block)
