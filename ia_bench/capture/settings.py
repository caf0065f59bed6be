"""What a capture leaves out of a scene, as settings; the defaults leave everything in."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Literal

from pydantic import Field

from ia_bench.common.ranges import NO_NUMBER, Number

MADE = ("hull",)
"""The kinds of geometry that come from the images and masks, and need no mesh."""


@dataclass(frozen=True)
class CaptureSettings:
    """How a scene is photographed before anything is planned or fitted.

    Attributes:
        name: Of the choice ``capture=NAME`` that these settings began with; decides nothing.
        views: How many of the training views are taken, spread over the directions of the cameras; "all" of them.
        radiometry: "hdr" leaves images as they are; "ldr" exposes, clips and quantises them to 8-bit sRGB.
        exposure: Of "ldr": "fixed" is one exposure, which is known; "per_image" one for each image, which is not.
        percentile: Of "ldr": share of the object's pixels, in percent, that the exposure keeps below the clip.
        geometry: Where the mesh comes from: "given" by the scene, "smoothed" from that, or the visual "hull" of the masks.
        smoothing: Of "smoothed": standard deviation of the blur, as a share of the diagonal of the mesh's box.
        cells: Of "hull": cells of the grid along the longest side of the object.
        tolerated: Of "hull": how many views may see a point outside of their masks before it is cut away; 1 survives one wrong
            mask, and leaves a larger hull.
        triangles: Of "hull": about how many the mesh has at most.
    """

    name: str = field(default="as_read", metadata=NO_NUMBER)
    views: Number | Literal["all"] = "all"
    radiometry: Literal["hdr", "ldr"] = "hdr"
    exposure: Literal["fixed", "per_image"] = "fixed"
    percentile: Annotated[float, Field(gt=0, le=100)] = 98.0
    geometry: Literal["given", "smoothed", "hull"] = "given"
    smoothing: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    cells: Annotated[int, Field(ge=16, le=512)] = 192
    tolerated: Annotated[int, Field(ge=0, le=10)] = 0
    triangles: Annotated[int, Field(ge=100, le=10**6)] = 20_000

    @property
    def label(self) -> str:
        """What differs from a capture that leaves everything in, in words: "8 views, LDR, hull"; empty for nothing."""
        plain = CaptureSettings()
        changed = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != getattr(plain, f.name)}
        named = changed.pop("name", None)
        words = [_word(key, value) for key, value in changed.items() if named is None or key == "views"]
        return ", ".join(([named] if named else []) + words)


def _word(key: str, value: object) -> str:
    if key == "views":
        return f"{value} view" if value == 1 else f"{value} views"
    if isinstance(value, str):
        return value.upper() if key == "radiometry" else value.replace("_", " ")
    return f"{key} {value:g}" if isinstance(value, int | float) else f"{key} {value}"
