"""How a prior's predictions are used by a method that asks for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ia_bench.common.ranges import NO_NUMBER, Number, NumberOrAuto, Positive, UnitInterval, Weight


@dataclass(frozen=True)
class SupervisionSettings:
    """How the prior's predictions supervise the fit; the defaults are the paper's way.

    Attributes:
        kind: What a prediction of albedo is taken as. "target": the albedo itself, up to the scale that the method's ``ssi``
            leaves free. "similarity": a kernel that says which pixels share an albedo, not which one it is (after Diffusion-Based
            Material Regularization, arXiv 2606.31065). "sds": score distillation, which denoises the current render instead of
            sampling. Specular shading is a target in the first two (it varies with the view, so that no kernel of constant
            material applies), and distilled in the last.
        target_weight: Of the albedo as a target, or distilled; times the method's weight of the albedo.
        kernel_weight: Of the kernel, likewise.
        refinement: How much of what a prior corrects in the finished fit is taken over, as a share of the logarithm of the albedo's
            change; 0 asks for none. Only for a prior that can (``ia_bench.priors.contract.Refiner``).
        roughness_refinement: Likewise, as a share of the change of the roughness.
        parsimony: How far albedo and roughness move toward the means of places that resemble each other, a few times in a fit, with
            any prior and none (``ia_bench.methods.two_stage.parsimony``); 0 leaves them where they are.
        neighbours: At how many photographs that look straight at it (from the side each counts by its cosine) a texel keeps half
            of its albedo and roughness at the end and takes half from around it (``ia_bench.methods.two_stage.looks``); at 0 it
            keeps all.
        symmetry: How far what no photograph shows moves, at the end, from its neighbours in the texture toward what is as high and
            as far from the object's vertical axis (``ia_bench.methods.two_stage.symmetry``); 0 leaves it there.
        specular_weight: Of this prior's specular shading, times the method's weight of it.
        kernel_scale: Standard deviation of the kernel, a Euclidean distance of sRGB colours.
        radius: How far apart the pixels of a pair may be, as a fraction of the longer side of the image.
        views: How many training views the prior is asked about, and ``parsimony`` compares, evenly spread, "all", or "auto": as
            many as the plan finds to show the surface often enough. The image loss uses every view.
        sds_period: Steps between two distillations.
        sds_views: Views in each.
        cache: Whether unguided samples of priors that have a fingerprint are kept between runs. Decides no number.
    """

    kind: Literal["target", "similarity", "sds"] = "target"
    target_weight: Weight = 1.0
    kernel_weight: Weight = 0.01
    refinement: UnitInterval = 0.0
    roughness_refinement: UnitInterval = 0.0
    parsimony: UnitInterval = 0.0
    neighbours: Weight = 0.0
    symmetry: UnitInterval = 0.0
    specular_weight: Weight = 1.0
    kernel_scale: Positive = 0.1
    radius: Positive = 0.5
    views: NumberOrAuto | Literal["all"] = "all"
    sds_period: Number = 10
    sds_views: Number = 4
    cache: bool = field(default=True, metadata=NO_NUMBER)
