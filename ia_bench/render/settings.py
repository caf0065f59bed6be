"""Settings of the renderer; ``auto`` leaves the choice to the plan, which measures the scene first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from ia_bench.common.ranges import Number, NumberOrAuto

BYTES_PER_TEXEL = 128  # five channels, each with gradient, Adam's moments and copies; this and the next measured, rounded up
BYTES_PER_LIGHT_TEXEL = 2000  # most of it the tables that sample it

REFERENCE = "ia_bench reference"
REFERENCE_BOUNCES = 4  # reflections between the parts of the object; what more would add is below 1 % of the light
REFERENCE_ATLAS = 256  # texels along a side of the atlas between whose texels light is exchanged; a fit takes 128
REFERENCE_LIGHT_ROWS = 128  # of the map by which an environment that is no map is taken
"""The renderer by which methods are compared: all shadows traced, a layered coat, and these. They are part of the protocol."""

BROUGHT = "pictures as they were brought"
"""In the place of a renderer where pictures were made elsewhere: nothing about them can be changed, the scale of albedo no more."""


@dataclass(frozen=True)
class RenderSettings:
    """How much work one pixel gets.

    Attributes:
        samples: Directions per pixel in an optimisation step, half of them drawn by the light and half by the BRDF. The
            dual-buffer loss splits them into two estimates, each rounded to a multiple of twice the points of a pixel;
            ``counters.samples_per_pixel`` of metrics.json says how many were taken.
        subsamples: G-buffer points along one side of a pixel (2 means 2 x 2) or "auto".
        texture: Side of the material textures in texels or "auto".
        light_height: Rows of the lat-long light (it has twice as many columns) or "auto".
        shadows: "traced" (exact), "none" or "auto".
        bounces: How often light may be reflected between the parts of the object before it is seen: 0 is direct light only,
            "auto" as often as a probe finds to matter.
        coat: "layered", the specular lobe takes its share of the light before the diffuse one, as in a Principled BSDF;
            "added", both get all of it, as in the paper's equation 2.
        metallic: Whether a metallic texture is recovered too; "auto" where the scene's description says that parts are metal, or,
            if it says nothing, where two short fits find that photographs ask for it (:mod:`ia_bench.methods.two_stage.metal`).
        control_variate: Whether diffuse light is estimated with a control variate, which removes most of its noise
            (:mod:`ia_bench.render.control`). It needs bounces, and a light that does not turn.
    """

    samples: Number = 32
    subsamples: Annotated[int, Field(ge=1, le=16)] | Literal["auto"] = "auto"
    texture: NumberOrAuto = "auto"
    light_height: NumberOrAuto = "auto"
    shadows: Literal["auto", "traced", "none"] = "auto"
    bounces: Annotated[int, Field(ge=0, le=64)] | Literal["auto"] = "auto"
    coat: Literal["layered", "added"] = "layered"
    metallic: bool | Literal["auto"] = "auto"
    control_variate: bool = True

    def memory(self) -> dict[str, int]:
        """Bytes that a fit takes, by the key that decides them."""
        texture = 0 if self.texture == "auto" else self.texture**2 * BYTES_PER_TEXEL
        light = 0 if self.light_height == "auto" else 2 * self.light_height**2 * BYTES_PER_LIGHT_TEXEL
        return {"texture": texture, "light_height": light}
