"""Views of several sizes as views of one, which is what fits and priors take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ia_bench.scenes.scene import View


def of_one_size(views: Sequence[View]) -> tuple[View, ...]:
    """The same photographs, padded at the right and at the bottom to the largest height and width among them.

    Pixels keep their places and so their rays. What was added is unknown: black, mask 0, not ``valid``.
    """
    height, width = (max(sizes) for sizes in zip(*(view.mask.shape for view in views), strict=True))
    return tuple(view if view.mask.shape == (height, width) else _padded(view, height, width) for view in views)


def _padded(view: View, height: int, width: int) -> View:
    known = np.ones(view.mask.shape, bool) if view.valid is None else view.valid
    arrays = {part.name: getattr(view, part.name) for part in fields(view)} | {"valid": known}
    more = (0, height - view.mask.shape[0]), (0, width - view.mask.shape[1])
    padded: dict[str, Any] = {
        name: np.pad(values, (*more, (0, 0))[: values.ndim]) for name, values in arrays.items() if isinstance(values, np.ndarray)
    }
    return replace(view, camera=replace(view.camera, height=height, width=width), **padded)
