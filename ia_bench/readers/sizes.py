"""How much of a dataset is read: smaller images, fewer held-out views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.readers.contract import TRUTH_OF_VIEWS
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
    """The view with the mean of every ``block`` x ``block`` pixels in place of them; incomplete blocks at the edges are left out.

    Everything in a view is premultiplied by coverage, so means of blocks are what a larger pixel would have seen.
    """
    if block == 1:
        return view
    camera = view.camera
    height, width = camera.height // block, camera.width // block
    if not height or not width:
        raise InputError(f"reader.options.shrink: expected at most {min(camera.height, camera.width)}, found {block}")

    def mean(values: np.ndarray) -> np.ndarray:
        blocks = values[: height * block, : width * block].reshape(height, block, width, block, -1)
        return blocks.mean((1, 3), dtype=np.float64).astype(np.float32).reshape(height, width, *values.shape[2:])

    valid = None if view.valid is None else mean(view.valid) == 1  # a block is known where all of it is
    known: dict[str, Any] = {name: mean(getattr(view, name)) for name in TRUTH_OF_VIEWS if getattr(view, name) is not None}
    focal, centre = ((pair[0] / block, pair[1] / block) for pair in (camera.focal, camera.centre))
    smaller = replace(camera, focal=focal, centre=centre, width=width, height=height)
    return replace(view, camera=smaller, image=mean(view.image), mask=mean(view.mask), valid=valid, **known)
