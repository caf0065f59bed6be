"""From numbers per image to one number, and the reasons beside the numbers that do not exist.

A value per image is a float or the :class:`Undefined` that explains its absence. The mean exists only where every image
has a value: a mean over the images that happened to work would reward failing on the hard ones. Views without a scored
pixel, which are the same for every method, are left out. An infinite PSNR (identical images) makes the mean infinite.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ia_bench.scores.metrics import NoScoredPixel, Undefined

Value = float | Undefined


def mean_over_images(values: Sequence[Value]) -> float | None:
    """Arithmetic mean over the images with scored pixels; None where there is no such image or one has no value."""
    scored = [value for value in values if not isinstance(value, NoScoredPixel)]
    numbers = [value for value in scored if not isinstance(value, Undefined)]
    return math.fsum(numbers) / len(numbers) if numbers and len(numbers) == len(scored) else None


def explain(values: Sequence[Value]) -> str | None:
    """Why some of the values are null in JSON, grouped by reason; None where all are finite numbers.

    >>> explain([20.0, float("inf")])
    'identical (image 1)'
    """
    if not values:
        return "no image"
    where: dict[str, list[int]] = {}
    for index, value in enumerate(values):
        if isinstance(value, Undefined):
            where.setdefault(str(value), []).append(index)
        elif math.isinf(value):
            where.setdefault("identical", []).append(index)
    return "; ".join(f"{reason} ({_named(found, len(values))})" for reason, found in where.items()) or None


def finite_or_none(tree: object) -> object:
    """Copy nested dicts and lists, with None for every :class:`Undefined` and every infinity (JSON has neither)."""
    if isinstance(tree, Mapping):
        return {key: finite_or_none(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [finite_or_none(value) for value in tree]
    if isinstance(tree, Undefined) or (isinstance(tree, float) and math.isinf(tree)):
        return None
    return tree


def _named(indices: list[int], total: int) -> str:
    if len(indices) == total:
        return "every image"
    return f"image{'s' if len(indices) > 1 else ''} {', '.join(map(str, indices))}"
