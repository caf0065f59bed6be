"""Every choice of the two-stage trainer that the paper leaves open, as one documented setting (see docs/choices.md)."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class LossWeights:
    """Weights of the paper's equation 5: lambda_1 image, lambda_2 albedo, lambda_3 specular, lambda_4 smoothness.

    ``smooth`` is split into the part of the albedo and the part of the roughness.
    """

    image: float = 1.0
    albedo: float = 1.0
    specular: float = 1.0
    smooth_albedo: float = 0.02
    smooth_roughness: float = 0.1


@dataclass(frozen=True)
class LearningRates:
    """Adam rates of albedo, roughness (both in [0, 1] units) and the light (log radiance).

    Over the run they fall exponentially to ``final`` times their value.
    """

    albedo: float = 0.03
    roughness: float = 0.1
    light: float = 0.2
    final: float = 0.05


@dataclass(frozen=True)
class FitSettings:
    """Two stages of ``stage1_steps`` and ``stage2_steps`` Adam steps over ``pixels`` random foreground pixels each.

    ``guided``: stage 2 draws samples again with the current renders as guidance; otherwise it goes on with stage 1's.
    ``image_loss``: "l1" of tone-mapped radiance (value and gradient from the same samples: biased, robust) or "squared"
    (the residual from an independent second estimate: unbiased gradient, twice the samples).
    ``ssi``: how a prior's albedo is aligned with the prediction, per view: "scale", "scale_shift"
    (mean and spread, as in Ranftl et al.) or "none".
    ``albedo_start``: fraction of all steps in which the albedo stays as it is and the light alone explains the images.
    ``roughness_start``: fraction of all steps after which roughness is optimised; until the light is right it would
    only learn the light's error. ``roughness_initial``, ``albedo_initial``: constant start of the textures (of
    the albedo only where no prior gives a better one).
    ``smooth_scale``: colour difference (log radiance) at which a pair of neighbouring pixels stops being smoothed.
    ``light_uniform``: fraction of light samples spread over the sphere, so that dark texels are visited too.
    """

    stage1_steps: int = 400
    stage2_steps: int = 200
    pixels: int = 4096
    weights: LossWeights = field(default_factory=LossWeights)
    rates: LearningRates = field(default_factory=LearningRates)
    guided: bool = True
    image_loss: str = "l1"
    ssi: str = "scale"
    albedo_start: float = 0.1
    roughness_start: float = 0.3
    roughness_initial: float = 0.5
    albedo_initial: float = 0.5
    smooth_scale: float = 0.1
    light_uniform: float = 0.2
    checkpoint_seconds: float = 15.0
