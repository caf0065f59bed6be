"""What a capture leaves out of a scene, as settings; the defaults leave everything in."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Annotated, Literal

from pydantic import Field

from ia_bench.common.files import is_file, read_yaml
from ia_bench.common.paths import conf_folder
from ia_bench.common.ranges import NO_NUMBER, Number
from ia_bench.common.settings import parsed

MADE = ("hull", "sdf")
"""The kinds of geometry that come from the images and masks, and need no mesh."""


@dataclass(frozen=True)
class FaultSettings:
    """What goes wrong with training views, each fault by itself; none does by default. Pixels are those of the images.

    Attributes:
        seed: The seed of all random draws below; those of a view depend on it and on the view's name.
        poses: Pixels by which wrong cameras move points of the object in their images, root mean square.
        mask_growth: Pixels by which every mask is too large; below 0 too small.
        mask_jitter: Pixels by which the mask of each view is at most too large or too small besides, drawn evenly.
        wrong_masks: Number of views whose mask has lost one half of the object.
        blurred_views: Number of views that are out of focus.
        blur: Standard deviation of their blur, pixels.
    """

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    poses: Annotated[float, Field(ge=0, le=20)] = 0.0
    mask_growth: Annotated[float, Field(ge=-20, le=20)] = 0.0
    mask_jitter: Annotated[float, Field(ge=0, le=20)] = 0.0
    wrong_masks: Annotated[int, Field(ge=0, le=10**4)] = 0
    blurred_views: Annotated[int, Field(ge=0, le=10**4)] = 0
    blur: Annotated[float, Field(gt=0, le=50)] = 2.0


@dataclass(frozen=True)
class SdfSettings:
    """How ``capture.geometry=sdf`` makes a surface of images and masks; nothing else reads them.

    Attributes:
        cells: Cells of the grid of distances along its longest side, margins included; about as many as the object has pixels.
        steps: Steps of the refinement on the images; 0 takes what stereo finds inside of the hull.
        seed: The seed of the pixels of each step.
        align: Whether photographs may move on their picture planes while the surface is refined, and their cameras with them: so
            poses that are a little off are put right.
    """

    cells: Annotated[int, Field(ge=32, le=256)] = 128
    steps: Annotated[int, Field(ge=0, le=10**5)] = 400
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    align: bool = False


@dataclass(frozen=True)
class CaptureSettings:
    """How a scene is photographed before anything is planned or fitted.

    Attributes:
        name: The name of the choice ``capture=NAME`` that these settings began with; decides nothing.
        views: How many of the training views are taken, spread over the directions of the cameras; "all" of them.
        radiometry: "hdr" leaves images as they are; "ldr" exposes, clips and quantises them to 8-bit sRGB.
        exposure: "fixed" is one exposure, or what cameras recorded of several; "per_image" one for each image, which is not known,
            or known by such a record alone roughly: "ldr" exposes them so, and of "hdr" it says that the images were.
        white_balance: "fixed", or "per_image": the images were multiplied by three factors each that are not known, exposure and
            white balance; nothing is simulated.
        percentile: Share of the object's pixels, in percent, that an exposure keeps below the clip.
        jpeg: Quality of the JPEG that each photograph of "ldr" goes through, 1 to 95 as encoders count; "none" keeps all bits.
        background: Grey behind the object, as a share of the radiance at ``percentile``: pixels at the edge mix it in, and a mask
            that is too large shows it. "none": the object is cut out without any.
        light: "static" stands still about the object; "turntable" stands still about the camera while the object turns on an axis;
            "camera" is fixed to the camera, as a lamp on it is, or any before which an object is turned by hand.
        turntable_axis: Direction of the axis of "turntable" in the object's coordinates; "auto" fits it to the cameras.
        faults: What goes wrong besides.
        consistency: Rounds in which poses and masks are made to agree with the hull of all masks, before anything else is made of
            them; 0 takes them as they are.
        margin: Pixels along the inside of every mask that a fit does not see, nor anything outside of it; 0 shows it all.
        geometry: Where the mesh comes from: "given" by the scene, "smoothed" from that, the visual "hull" of the masks, or "sdf", a
            surface that is made of masks and images.
        smoothing: Standard deviation of the blur of "smoothed", as a share of the diagonal of the mesh's box.
        cells: Cells of the grid of "hull" along its longest side, margins included.
        tolerated: How many views may see a point outside of their masks before "hull" and "sdf" cut it away; 1 survives one wrong
            mask, and leaves a larger hull.
        triangles: About how many triangles the mesh of "hull" and "sdf" has at most.
        sdf: How "sdf" is made.
    """

    name: str = field(default="as_read", metadata=NO_NUMBER)
    views: Number | Literal["all"] = "all"
    radiometry: Literal["hdr", "ldr"] = "hdr"
    exposure: Literal["fixed", "per_image"] = "fixed"
    white_balance: Literal["fixed", "per_image"] = "fixed"
    percentile: Annotated[float, Field(gt=0, le=100)] = 98.0
    jpeg: Annotated[int, Field(ge=1, le=95)] | Literal["none"] = "none"
    background: Annotated[float, Field(ge=0, le=10)] | Literal["none"] = "none"
    light: Literal["static", "turntable", "camera"] = "static"
    turntable_axis: tuple[float, float, float] | Literal["auto"] = "auto"
    faults: FaultSettings = field(default_factory=FaultSettings)
    consistency: Annotated[int, Field(ge=0, le=20)] = 0
    margin: Annotated[float, Field(ge=0, le=100)] = 0.0
    geometry: Literal["given", "smoothed", "hull", "sdf"] = "given"
    smoothing: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    cells: Annotated[int, Field(ge=16, le=512)] = 192
    tolerated: Annotated[int, Field(ge=0, le=10)] = 0
    triangles: Annotated[int, Field(ge=100, le=10**6)] = 20_000
    sdf: SdfSettings = field(default_factory=SdfSettings)

    @property
    def label(self) -> str:
        """What differs from a capture that leaves everything in, in words: "8 views, LDR, hull"; empty for nothing.

        A choice of another name is called by that, and what differs from what is shipped under it: "phone, 8 views".
        """
        changed = _changed(self, shipped(self.name))
        changed.pop("name", None)
        named = [] if self.name == CaptureSettings.name else [self.name]
        return ", ".join(named + [_word(key, value) for key, value in changed.items()])

    @property
    def others(self) -> str:
        """The label without the number of views: what else the capture leaves out."""
        return replace(self, views="all").label


@cache
def shipped(name: str) -> CaptureSettings:
    """The capture that ``conf/capture/NAME.yaml`` describes, one that leaves everything in where there is no such file."""
    path = conf_folder() / "capture" / f"{name}.yaml"
    return parsed(CaptureSettings, read_yaml(path), "capture") if is_file(path) else CaptureSettings()


Settings = CaptureSettings | FaultSettings | SdfSettings


def _changed(settings: Settings, plain: Settings, part: str = "") -> dict[str, object]:
    """The settings that differ from ``plain``, those of a part among them; of "sdf" with that before their names."""
    found: dict[str, object] = {}
    for one in fields(settings):
        value, usual = getattr(settings, one.name), getattr(plain, one.name)
        if isinstance(value, FaultSettings | SdfSettings):
            found |= _changed(value, usual, "sdf " if isinstance(value, SdfSettings) else "")
        elif value != usual:
            found[part + one.name] = value
    return found


def _word(key: str, value: object) -> str:
    if isinstance(value, tuple):
        return "axis " + " ".join(f"{part:g}" for part in value)
    if key in ("light", "white_balance"):
        return f"{key} {value}".replace("_", " ")
    if key == "views":
        return f"{value} view" if value == 1 else f"{value} views"
    if value == "none":
        return f"no {key}"
    if isinstance(value, str):
        return value.upper() if key == "radiometry" else value.replace("_", " ")
    return f"{key.replace('_', ' ')} {value}"
