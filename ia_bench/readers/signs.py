"""Signs in the pixels that a dataset is not what its format says. Nothing is refused for them: a note warns.

Each is a number that sound images hardly have; tests/readers/test_signs.py measures what the shipped scenes have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import uniform_filter

from ia_bench.scenes.scene import View

SOLID, EDGE = 0.95, (0.1, 0.5)  # coverages: of pixels inside the object, and of those whose colour alpha decides
LEAST_PIXELS = 100  # of an edge; fewer prove nothing
FADED, GLARING = 0.5, 2.0  # colour of edges over colour beside them; 1 is right, about .3 and 3 are alpha once too often or seldom
EIGHT_BIT_VALUES = 256
HALF = 2.0**-11  # relative rounding of half floats


def warnings_of(views: Sequence[View]) -> Iterator[str]:
    """One line for every sign that the training ``views`` show."""
    ratio = edge_colour(views)
    if ratio is not None and ratio < FADED:
        yield (
            f"warning: half-covered pixels are {ratio:.2f} times as bright as the object beside them: "
            "the colours seem to be multiplied by alpha twice (PNG files are expected to hold straight alpha)"
        )
    if ratio is not None and ratio > GLARING:
        yield (
            f"warning: half-covered pixels are {ratio:.2f} times as bright as the object beside them: "
            "the colours seem not to be multiplied by alpha (OpenEXR files are expected to be premultiplied)"
        )
    if in_eight_bits(views):
        yield "warning: the linear images hold 8-bit steps from 0 to 1 only: they seem to be sRGB pictures stored as linear"


def edge_colour(views: Sequence[View]) -> float | None:
    """Mean colour of half-covered pixels, divided by alpha, over that of solid pixels beside them; None for too few of them."""
    edge = beside = 0.0
    count = 0
    for view in views:
        solid = (view.mask > SOLID).astype(np.float32)
        near = uniform_filter(solid, 5)
        colour = uniform_filter(view.image.mean(-1) * solid, 5) / np.maximum(near, 1e-6)
        chosen = (view.mask > EDGE[0]) & (view.mask < EDGE[1]) & (near > 0.1)
        edge += float((view.image.mean(-1)[chosen] / view.mask[chosen]).sum())
        beside += float(colour[chosen].sum())
        count += int(chosen.sum())
    return edge / beside if count >= LEAST_PIXELS and beside > 0 else None


def in_eight_bits(views: Sequence[View]) -> bool:
    """Whether every solid pixel of all views is a multiple of 1/255 up to 1, in many different steps."""
    values = np.unique(np.concatenate([view.image[view.mask >= 1].ravel() for view in views]))
    if len(values) < 16 or len(values) > EIGHT_BIT_VALUES or values[-1] > 1:
        return False
    steps = 255 * values.astype(np.float64)
    return bool((np.abs(steps - np.round(steps)) <= HALF * steps + 1e-3).all())
