"""What may be set of the plain loop of Mitsuba 3 and Adam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from ia_bench.common.ranges import Number, Positive, Rate, UnitInterval, Weight


@dataclass(frozen=True)
class MitsubaAdamOptions:
    """The defaults are those of ``two_stage`` wherever it has the same setting. Samples a pixel are ``render.samples``.

    Attributes:
        steps: Adam steps; each renders one random training view.
        depth: Longest light path: 2 is direct light, every further one a reflection between parts of the object.
        albedo_weight: Weight of the prior's albedo beside the images.
        albedo_rate: Adam rate of the albedo.
        roughness_rate: Adam rate of the roughness.
        light_rate: Adam rate of the log radiance of the light.
        final_rate: What the rates fall to over the fit, as a fraction.
        albedo_initial: Mean albedo at the start, in the images' mean colour, where no prior gives one.
        roughness_initial: Roughness at the start.
    """

    steps: Number = 600
    depth: Annotated[int, Field(ge=2, le=64)] = 2
    albedo_weight: Weight = 1.0
    albedo_rate: Rate = 0.03
    roughness_rate: Rate = 0.1
    light_rate: Rate = 0.2
    final_rate: Positive = 0.05
    albedo_initial: UnitInterval = 0.5
    roughness_initial: UnitInterval = 0.5
