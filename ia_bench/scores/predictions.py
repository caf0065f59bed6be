"""What is compared with what: pictures of a reconstruction, and the un-premultiplied pairs that the metrics see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ia_bench.scenes.images import Images, straight


@dataclass(frozen=True)
class Predictions:
    """Everything that is scored of one scene; ground truth has the same form. None stands for what there is not.

    Attributes:
        albedo: (H, W, 3) of the test views.
        roughness: (H, W) of the test views.
        view_synthesis: (H, W, 3) radiance under the training light.
        relighting: The same per novel light, rendered with the *aligned* albedo.
    """

    albedo: Images | None = None
    roughness: Images | None = None
    view_synthesis: Images | None = None
    relighting: Mapping[str, Images] | None = None


@dataclass(frozen=True)
class Pair:
    """One view, un-premultiplied.

    Attributes:
        predicted: Linear (H, W[, 3]).
        true: The same of the truth.
        mask: (H, W), True where scored: where the object is, and the truth known.
        known: (H, W), True where the truth is known.
        coverage: (H, W) each, of prediction and truth. What the prediction does not cover counts as black.
    """

    predicted: np.ndarray
    true: np.ndarray
    mask: np.ndarray
    known: np.ndarray
    coverage: tuple[np.ndarray, np.ndarray]


def pairs(predicted: Images, true: Images, mask_threshold: float, what: str) -> list[Pair]:
    """Pair the views by position. ``what`` names the component in errors.

    Raises ValueError where the two sets differ in number or shape, or the truth is not finite in a scored pixel.
    """
    if len(predicted) != len(true):
        raise ValueError(f"{what}: expected {len(true)} views, found {len(predicted)}")
    result = []
    for index in range(len(true)):
        theirs, ours = true.images[index], predicted.images[index]
        if theirs.shape != ours.shape:
            raise ValueError(f"{what}, view {index}: expected shape {theirs.shape}, found {ours.shape}")
        given = None if true.known is None else true.known[index]
        known = np.ones(theirs.shape[:2], bool) if given is None else given
        mask = (true.coverage[index] > mask_threshold) & known
        truth = straight(theirs, true.coverage[index]).astype(np.float64)
        if not np.isfinite(truth[mask]).all():
            raise ValueError(f"{what}, view {index}: the ground truth is not finite")
        guess = straight(ours, predicted.coverage[index]).astype(np.float64)
        result.append(Pair(guess, truth, mask, known, (predicted.coverage[index], true.coverage[index])))
    return result


def stacked(views: list[Pair]) -> tuple[np.ndarray, np.ndarray]:
    """All scored pixels of all views, predicted and true, each (N, 3): what an alignment is computed from."""
    empty = np.zeros((0, 3))
    predicted = np.concatenate([empty, *(view.predicted[view.mask] for view in views)])
    return predicted, np.concatenate([empty, *(view.true[view.mask] for view in views)])
