"""Every choice of the two-stage trainer that the paper leaves open, as one documented setting (see docs/choices.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ia_bench.common.errors import InputError
from ia_bench.common.typed import check_ranges

KINDS = ("target", "similarity", "sds")
TINY = 1e-6  # the least value of what divides


@dataclass(frozen=True)
class LossWeights:
    """Weights of the paper's equation 5: lambda_1 image, lambda_2 albedo, lambda_3 specular, lambda_4 smoothness.

    ``smooth`` is split into the part of the albedo and the part of the roughness, which is that of metallic too.
    ``smooth_light``: of the total variation of the light's log radiance (see ``losses.total_variation``).
    """

    image: float = 1.0
    albedo: float = 1.0
    specular: float = 1.0
    smooth_albedo: float = 0.02
    smooth_roughness: float = 0.1
    smooth_light: float = 0.0003


@dataclass(frozen=True)
class LearningRates:
    """Adam rates of albedo, roughness, metallic (in [0, 1] units) and the light (log radiance).

    ``cast``: of a log factor per channel that the light takes from the albedo, both in one step; 0 leaves it out.
    Over the run they fall exponentially to ``final`` times their value.
    """

    albedo: float = 0.03
    roughness: float = 0.1
    metallic: float = 0.05
    light: float = 0.2
    cast: float = 0.05
    final: float = 0.05


@dataclass(frozen=True)
class FitSettings:
    """Two stages of ``stage1_steps`` and ``stage2_steps`` Adam steps over ``pixels`` random foreground pixels each.

    ``guided``: stage 2 draws samples again with the current renders as guidance; otherwise it goes on with stage 1's.
    ``image_loss``: "crossed", each half of a pixel's samples weighed by the residual of the other half, cut at
    ``residual_cut`` (``losses.crossed_loss``: noise pulls nowhere), or "l1" of tone-mapped radiance, value and
    gradient from the same samples: it also fits a light and a material whose renders have little noise.
    ``ssi``: how a prior's albedo is aligned with the prediction, per view: "scale", "scale_shift"
    (mean and spread, as in Ranftl et al.) or "none".
    ``albedo_start``: fraction of all steps in which the albedo stays as it is and the light alone explains the images.
    ``roughness_start``: fraction of all steps after which roughness is optimised; until the light is right it would
    only learn the light's error; so is metallic. ``cast_start``: fraction of all steps after which light and albedo exchange
    a colour; highlights, which decide it, must be there first. ``roughness_initial``, ``metallic_initial``,
    ``albedo_initial``: constant start of the textures (of the albedo only where no prior gives a better one).
    There the albedo has the images' mean colour and the light is grey: images alone hardly tell the two apart later.
    ``smooth_scale``: colour difference (log radiance) at which a pair of neighbouring pixels stops being smoothed.
    ``light_uniform``: fraction of light samples spread over the sphere, so that dark texels are visited too.
    """

    stage1_steps: int = 400
    stage2_steps: int = 200
    pixels: int = 4096
    weights: LossWeights = field(default_factory=LossWeights)
    rates: LearningRates = field(default_factory=LearningRates)
    guided: bool = True
    image_loss: str = "crossed"
    residual_cut: float = 0.1
    ssi: str = "scale"
    albedo_start: float = 0.1
    roughness_start: float = 0.3
    cast_start: float = 0.3
    roughness_initial: float = 0.5
    metallic_initial: float = 0.5
    albedo_initial: float = 0.5
    smooth_scale: float = 0.1
    light_uniform: float = 0.2
    checkpoint_seconds: float = 15.0


@dataclass(frozen=True)
class SupervisionSettings:
    """How the prior's predictions supervise the fit; the defaults are the paper's way.

    ``kind``: what a prediction of albedo is taken as. "target": the albedo itself, up to the scale that ``fit.ssi``
    leaves free. "similarity": a kernel that says which pixels share an albedo, not which one it is (after Diffusion-Based
    Material Regularization, arXiv 2606.31065).
    "sds": score distillation, which denoises the current render instead of sampling. Specular shading is a target in all but
    the last (it varies with the view, so that no kernel of constant material applies), where it is distilled.
    ``target_weight``, ``kernel_weight``: of the terms of the albedo, all times ``fit.weights.albedo``;
    ``specular_weight`` times ``fit.weights.specular``: how far this prior's specular shading is to be trusted.
    ``kernel_scale``: standard deviation of the kernel, a Euclidean distance of sRGB colours.
    ``radius``: how far apart the pixels of a pair may be, as a fraction of the longer side of the image.
    ``views``: how many training views the prior is asked about, evenly spread, "all", or "auto": as many as the plan finds
    to show the surface often enough. The image loss uses every view.
    ``sds_period``: steps between two distillations; ``sds_views``: views in each.
    ``cache``: keep unguided samples of priors that have a fingerprint between runs. Decides no number.
    """

    kind: str = "target"
    target_weight: float = 1.0
    kernel_weight: float = 0.01
    specular_weight: float = 1.0
    kernel_scale: float = 0.1
    radius: float = 0.5
    views: int | str = "all"
    sds_period: int = 10
    sds_views: int = 4
    cache: bool = True


FIT_RANGES = {
    "weights.image": (0, math.inf),
    "weights.albedo": (0, math.inf),
    "weights.specular": (0, math.inf),
    "weights.smooth_albedo": (0, math.inf),
    "weights.smooth_roughness": (0, math.inf),
    "weights.smooth_light": (0, math.inf),
    "rates.albedo": (0, math.inf),
    "rates.roughness": (0, math.inf),
    "rates.metallic": (0, math.inf),
    "rates.light": (0, math.inf),
    "rates.cast": (0, math.inf),
    "rates.final": (TINY, math.inf),
    "stage1_steps": (0, math.inf),
    "stage2_steps": (0, math.inf),
    "pixels": (1, math.inf),
    "residual_cut": (TINY, math.inf),
    "albedo_start": (0, 1),
    "roughness_start": (0, 1),
    "cast_start": (0, 1),
    "roughness_initial": (0, 1),
    "metallic_initial": (0, 1),
    "albedo_initial": (0, 1),
    "smooth_scale": (TINY, math.inf),
    "light_uniform": (0, 1),
    "checkpoint_seconds": (0, math.inf),
}
"""Least and largest value of every number of :class:`FitSettings`; all are finite."""
FIT_CHOICES = {
    "image_loss": ("crossed", "l1"),
    "ssi": ("scale_shift", "scale", "none"),
}


def check_fit(settings: FitSettings) -> None:
    """Raise InputError, naming the key, for a value that cannot be meant."""
    for key, choices in FIT_CHOICES.items():
        if getattr(settings, key) not in choices:
            raise InputError(f"fit.{key}: expected one of {', '.join(choices)}, found {getattr(settings, key)!r}")
    check_ranges(settings, FIT_RANGES, "fit.")


def check_supervision(settings: SupervisionSettings) -> None:
    """Raise InputError, naming the key, for a value or a combination that cannot be meant."""
    key = "prior.supervision."
    if settings.kind not in KINDS:
        raise InputError(f"{key}kind: expected one of {', '.join(KINDS)}, found {settings.kind!r}")
    for name in ("kernel_scale", "radius"):
        value = getattr(settings, name)
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{key}{name}: expected a finite number > 0, found {value}")
    for name in ("target_weight", "kernel_weight", "specular_weight"):
        value = getattr(settings, name)
        if not (math.isfinite(value) and value >= 0):
            raise InputError(f"{key}{name}: expected a finite number >= 0, found {value}")
    for name in ("sds_period", "sds_views"):
        value = getattr(settings, name)
        if value < 1:
            raise InputError(f"{key}{name}: expected at least 1, found {value}")
    views = settings.views
    if views not in ("all", "auto") and not (isinstance(views, int) and views >= 1):
        raise InputError(f"{key}views: expected a number of views >= 1, all or auto, found {views}")
