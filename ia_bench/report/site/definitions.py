"""What every number of the page means, in a sentence or two that stand beside it; docs/protocol.md has the whole definition."""

from __future__ import annotations

from ia_bench.scores.columns import Metric

COMPONENTS = {
    "albedo": "Albedo of the test views against the truth, as it was recovered",
    "aligned_albedo": "Albedo of the test views after one factor for all views and channels has matched its mean to the truth's",
    "view_synthesis": "Photographs from new viewpoints under the training light",
    "relighting": "Photographs under lights that no method has seen, drawn with the aligned albedo",
    "roughness": "Perceptual roughness of the test views, from 0 to 1",
}
"""Component of a metric -> what is compared with what."""

MEASURES = {
    "psnr": "Peak signal-to-noise ratio in dB over the object's pixels, sRGB-encoded, averaged over images",
    "ssim": "Structural similarity, 1 for equal images",
    "lpips": "Perceptual distance by a network, 0 for equal images",
    "mse": "Mean squared error over the object's pixels",
}
"""Name of a metric -> how it is measured."""

COSTS = {
    "seconds": "Baking, prior and fit, without scoring and without the preparation of the scene (its capture, a mesh made for it), "
    "which is the same for every row: mean over scenes and seeds, on the machine that each run names",
    "memory": "The largest resident memory of any of the row's processes",
    "failed": "Runs that ended without scores, of all runs. They enter no mean",
}
"""Key of a cost -> what it counts."""

INTERVAL = (
    "± is a 95 % interval over seeds (Student's t, Welch and Satterthwaite over scenes): how far other seeds on the same scenes "
    "would move the mean. It says nothing of other scenes."
)

HEADROOM = (
    "The bar behind a number is the share of the way from the floor (one grey) to the ceiling (the truth, as the scorer draws it) "
    "that the row goes."
)

WHY_THE_PAPER_DIFFERS = (
    "The paper measured on its own scenes, with its own renderer and trained weights, and leaves mask, encoding and alignment "
    "open. Orders may be compared, levels may not."
)


def definition(metric: Metric) -> str:
    """What a column shows, and which direction is better."""
    better = "Higher" if metric.higher_is_better else "Lower"
    said = MEASURES.get(metric.name) or (metric.of.__doc__ or metric.label).splitlines()[0].rstrip(".")  # of a metric that is new
    return f"{COMPONENTS[metric.component]}. {said}. {better} is better."
