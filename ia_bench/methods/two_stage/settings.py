"""Every choice of the two-stage trainer that the paper leaves open, as one documented setting (see docs/choices.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import Count, Number, Positive, Rate, Roughness, UnitInterval, Weight
from ia_bench.methods.regularisers.choice import options_for
from ia_bench.render.settings import RenderSettings

BYTES_PER_SAMPLE = 400  # of a step with its gradient: a ray, what it meets, what it carries


@dataclass(frozen=True)
class LossWeights:
    """Weights of the paper's equation 5: lambda_1 image, lambda_4 smoothness; lambda_2 and lambda_3 are ``coupling.options``.

    Attributes:
        image: The weight of the rendered image's difference from the photograph.
        smooth_albedo: The weight of differences of albedo between neighbours that look alike.
        smooth_roughness: The weight of differences of roughness, and of metallic, likewise.
        smooth_light: The weight of the total variation of the light's log radiance (``losses.total_variation``).
        smooth_light_final: What ``smooth_light`` falls to over the run, exponentially, as a fraction. It holds down the noise of
            steps, of which there is less as rates fall; what is more than that pulls lamps and dim surroundings together.
    """

    image: Weight = 1.0
    smooth_albedo: Weight = 0.02
    smooth_roughness: Weight = 0.1
    smooth_light: Weight = 0.0003
    smooth_light_final: Positive = 1.0


@dataclass(frozen=True)
class LearningRates:
    """Adam's rates; over the run they fall exponentially to ``final`` times their value.

    Attributes:
        albedo, roughness, metallic: In units of albedo, which is in [0, 1].
        light: In units of log radiance.
        scale_ambiguity: The rate of the log factor per channel that light and albedo exchange; 0 leaves that step out.
        final: Share of every rate that is left at the end.
    """

    albedo: Rate = 0.03
    roughness: Rate = 0.1
    metallic: Rate = 0.05
    light: Rate = 0.2
    scale_ambiguity: Rate = 0.05
    final: Positive = 0.05


@dataclass(frozen=True)
class MultigridRates:
    """Adam's rates of steps at coarser scales (``steps.MultigridSteps``), the same at each, units as above; 0 leaves them out."""

    albedo: Rate = 0.02
    roughness: Rate = 0.01
    metallic: Rate = 0.01
    light: Rate = 0.2


@dataclass(frozen=True)
class FitSettings:
    """Two stages of Adam steps over random foreground pixels.

    Attributes:
        stage1_steps: Steps with samples of the prior.
        stage2_steps: Steps with samples that were drawn toward the render after stage 1.
        pixels: In every step.
        weights: The weights of the parts of the loss.
        rates: The rates of the optimiser.
        multigrid_rates: The rates of its steps at coarser scales; they fall as the others do.
        guided: Whether stage 2 draws samples again, with the current renders as guidance; else it goes on with stage 1's.
        image_loss: "dual_buffer": each half of a pixel's samples weighed by the residual of the other half
            (``losses.dual_buffer_loss``: noise pulls nowhere). "l1" of tone-mapped radiance, value and gradient from the same
            samples: it also fits a light and a material whose renders have little noise.
        residual_cut: Where the dual-buffer loss cuts residuals; "auto": .05 with a control variate of diffuse light, and .1, since
            there is more noise, without one.
        albedo_start: Share of all steps in which the albedo stays as it is and the light alone explains the images.
        roughness_start: Share of all steps after which roughness, and metallic, are optimised; until the light is right they
            would only learn the light's error.
        scale_ambiguity_start: Share of all steps after which the scale-ambiguity step is taken; highlights, which decide it, must
            be there first.
        solve_albedo: Whether the albedo is solved for when all steps are done and the regularisers have been applied
            (``least_squares``), by the photographs alone; "auto": unless the coupling says which albedo a pixel has.
        roughness_initial: Constant start of the roughness.
        metallic_initial: Constant start of metallic.
        albedo_initial: Mean of the albedo at the start where no prior gives a better one. It has the images' mean colour then,
            and the light is grey: images alone hardly tell the two apart later.
        smooth_scale: Difference of log radiance at which a pair of neighbouring pixels stops being smoothed.
        defensive_share: Share of light samples spread over the sphere, so that dark texels are visited too.
        regularise: What changes the material by itself, in the order in which it is applied (:mod:`ia_bench.methods.regularisers`).
        regulariser_options: By its name, how much and how.
    """

    stage1_steps: Count = 200
    stage2_steps: Count = 100
    pixels: Number = 2048
    weights: LossWeights = field(default_factory=LossWeights)
    rates: LearningRates = field(default_factory=LearningRates)
    multigrid_rates: MultigridRates = field(default_factory=MultigridRates)
    guided: bool = True
    image_loss: Literal["dual_buffer", "l1"] = "dual_buffer"
    residual_cut: Positive | Literal["auto"] = "auto"
    albedo_start: UnitInterval = 0.1
    roughness_start: UnitInterval = 0.3
    scale_ambiguity_start: UnitInterval = 0.3
    solve_albedo: bool | Literal["auto"] = "auto"
    roughness_initial: Roughness = 0.5
    metallic_initial: UnitInterval = 0.5
    albedo_initial: UnitInterval = 0.5
    smooth_scale: Positive = 0.1
    defensive_share: UnitInterval = 0.2
    regularise: list[str] = field(default_factory=list)
    regulariser_options: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.stage1_steps + self.stage2_steps:
            raise InputError("fit.stage1_steps and fit.stage2_steps: expected at least one step, found none")
        object.__setattr__(self, "regulariser_options", options_for(self.regularise, self.regulariser_options))

    def memory(self, render: RenderSettings) -> dict[str, int]:
        """Bytes that a step takes, by the key that decides them."""
        return {"pixels": self.pixels * render.samples * BYTES_PER_SAMPLE}


PLAIN_ADAM: Mapping[str, Any] = {  # of all tensors from the first step, along equation 5 with an L1, and nothing else
    "image_loss": "l1",
    "weights": {"smooth_light": 0.0},
    "rates": {"scale_ambiguity": 0.0},
    "multigrid_rates": {"albedo": 0.0, "roughness": 0.0, "metallic": 0.0, "light": 0.0},
    "albedo_start": 0.0,
    "roughness_start": 0.0,
    "solve_albedo": False,
}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "smoke": {"stage1_steps": 12, "stage2_steps": 6, "pixels": 512},
    "full": {"stage1_steps": 800, "stage2_steps": 400, "weights": {"smooth_light": 0.001, "smooth_light_final": 0.05}},
    "letter": {**PLAIN_ADAM, "stage1_steps": 600, "stage2_steps": 400},
    "paper": {"stage1_steps": 20_000, "stage2_steps": 15_000, "pixels": 4096},
}
