"""The scoring protocol: every definition that decides a number, as one named object that is stored with the numbers.

``docs/protocol.md`` says the same in words, with the reasons.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_yaml
from ia_bench.common.paths import conf_folder
from ia_bench.common.settings import flat, parsed
from ia_bench.render.settings import REFERENCE, REFERENCE_ATLAS, REFERENCE_BOUNCES, REFERENCE_LIGHT_ROWS

Encoding = Literal["srgb", "linear"]
Count = Annotated[int, Field(ge=1, le=2**16)]  # points or samples: more would never end


@dataclass(frozen=True)
class SsimSettings:
    """Structural similarity (Wang et al. 2004) as scikit-image computes it, with a Gaussian window.

    ``sigma`` is the window's standard deviation in pixels; 11 x 11 pixels by default, ``side`` x ``side`` where that is given.
    ``border``: "valid", of whole images alone, leaves out pixels whose window reaches beyond the picture; "reflect" mirrors it.
    """

    TRUNCATE: ClassVar[float] = 3.5  # where the window is cut off, in sigma

    sigma: Annotated[float, Field(gt=0, le=1000)] = 1.5
    side: Annotated[int, Field(ge=1, le=99)] | None = None
    border: Literal["reflect", "valid"] = "reflect"

    def __post_init__(self) -> None:
        """Raise InputError for a window without a pixel in its middle."""
        if self.side is not None and self.side % 2 == 0:
            raise InputError(f"protocol.ssim.side: expected an odd number, found {self.side}")

    @property
    def window(self) -> int:
        """Width of the window in pixels (scikit-image's rule, unless it is given)."""
        return self.side or 2 * int(self.TRUNCATE * self.sigma + 0.5) + 1


@dataclass(frozen=True)
class LpipsSettings:
    """LPIPS 0.1 (Zhang et al. 2018) with the backbone ``net``.

    ``weights`` names a safetensors file with the full state dict of that network; None takes the package's own for
    "squeeze", and lets the ``lpips`` package download the others.
    """

    net: Literal["alex", "vgg", "squeeze"] = "squeeze"
    weights: str | None = None


@dataclass(frozen=True)
class ComparisonSettings:
    """What of two pictures is compared. The defaults are the paper's, under which all but ``area`` mean nothing.

    Attributes:
        area: Means are taken over the object's pixels, or over the whole image, with the object over a background.
        silhouette: What cuts out the object in a whole image: the scored pixels, each picture's own coverage, or the true one.
        background: The encoded grey behind the object, 0 or 1 in practice.
        erosion: Side of the square of pixels by which the scored pixels shrink (an odd number, 0 for none).
        rescale: Whether every predicted picture is first scaled, per channel, to the truth by least squares, in linear values.
        floor: Whether a PSNR counts as no less than that of an object of the grey .5.
        hdr_clip: Where linear values are cut for a PSNR without encoding, the variant ``_hdr``; None for no such number.
        lpips_encoded_again: Whether LPIPS sees the pictures through the sRGB curve once more.
    """

    area: Literal["object", "image"] = "object"
    silhouette: Literal["mask", "own", "truth"] = "mask"
    background: Annotated[float, Field(ge=0, le=1)] = 1.0
    erosion: Annotated[int, Field(ge=0, le=99)] = 0
    rescale: Literal["none", "per_channel"] = "none"
    floor: bool = False
    hdr_clip: Annotated[float, Field(gt=0)] | None = None
    lpips_encoded_again: bool = False

    def __post_init__(self) -> None:
        """Raise InputError for settings of whole images where the object is compared."""
        if self.area == "object" and any(getattr(self, f.name) != f.default for f in fields(self)):
            raise InputError("protocol.comparison: expected area=image with the other settings of whole images, found area=object")
        if self.erosion and self.erosion % 2 == 0:
            raise InputError(f"protocol.comparison.erosion: expected 0 or an odd number, found {self.erosion}")


@dataclass(frozen=True)
class Protocol:
    """How a reconstruction becomes numbers. The defaults are the protocol ``paper-v3``.

    Attributes:
        name: Put before everything else in the label.
        version: The version of this package's definitions, the only ones that it computes; raised whenever one changes a number.
        noise: What is done about the noise of renders. Its variance is part of the error ("kept"); or every picture is the mean of
            two independent ones of half the samples, by whose difference the variance is subtracted ("subtracted").
        albedo_encoding: What albedo is compared in, after clipping to [0, 1].
        radiance_encoding: The same for rendered images.
        alignment: How the one free scale of an albedo is fixed, always in linear values and over the whole test set.
        mask_threshold: Pixels whose true coverage is above it are scored.
        map_points: Points along a side of a pixel of an albedo or roughness map.
        render_points: Points along a side of a pixel of a view-synthesis or relighting render.
        samples_per_pixel: Directions of light that a pixel of such a render adds up.
        curve_stride: The curve during a run looks at every such view ...
        curve_samples: ... with at most so many samples a pixel ...
        curve_lights: ... under the first so many novel lights of the scene, None for all.
        seed: The seed of the directions; the same for every run, whatever its own seed.
    """

    name: str = "paper-v3"
    version: Literal[2, 3] = 3
    noise: Literal["kept", "subtracted"] = "subtracted"
    albedo_encoding: Encoding = "srgb"
    radiance_encoding: Encoding = "srgb"
    alignment: Literal["mean_rgb", "per_channel", "least_squares", "median_ratio", "none"] = "mean_rgb"
    mask_threshold: Annotated[float, Field(ge=0, lt=1)] = 0.5
    map_points: Count = 8
    render_points: Count = 4
    samples_per_pixel: Count = 128
    curve_stride: Count = 10
    curve_samples: Count = 64
    curve_lights: Count | None = 1
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    ssim: SsimSettings = field(default_factory=SsimSettings)
    lpips: LpipsSettings = field(default_factory=LpipsSettings)
    comparison: ComparisonSettings = field(default_factory=ComparisonSettings)

    def __post_init__(self) -> None:
        """Raise InputError for a border of whole images where the object is compared, and for what whole images cannot be."""
        if self.noise == "subtracted" and self.comparison.area == "image":
            raise InputError("protocol.noise=subtracted: expected comparison.area=object, found image")
        if self.ssim.border == "valid" and self.comparison.area == "object":
            raise InputError("protocol.ssim.border=valid: expected comparison.area=image, found object")

    @property
    def label(self) -> str:
        """The name, the LPIPS net, and all that differs from the shipped protocol of that name: numbers compare under one label.

        >>> Protocol(samples_per_pixel=64).label
        'paper-v3 (lpips.net=squeeze, samples_per_pixel=64)'
        """
        default, mine = flat(asdict(shipped(self.name))), flat(asdict(self))
        decisive = [key for key in mine if key not in ("name", "lpips.weights")]  # where weights lie decides nothing
        changed = [f"{key}={mine[key]}" for key in decisive if mine[key] != default[key] and key != "lpips.net"]
        return f"{self.name} ({', '.join([f'lpips.net={self.lpips.net}', *changed])})"

    def describe(self) -> dict[str, Any]:
        """Everything that decides the numbers, settings and fixed rules alike, for storing beside them (JSON types)."""
        ssim = {name: value for name, value in asdict(self.ssim).items() if value != getattr(SsimSettings, name) or name == "sigma"}
        known = {name: value for name, value in asdict(self).items() if name not in ("comparison", "noise")}
        if self.curve_lights is None:  # as former protocols were described, whose hash stays
            del known["curve_lights"]
        rules = {}
        if self.noise == "subtracted":
            halves = "pictures are means of two halves of the samples"
            rules["noise"] = f"{halves}; half their difference, squared, is subtracted in PSNR and SSIM"
        if self.comparison.area == "image":
            grey = "the background's grey around the object"
            rules |= {
                "mask_rule": "all pixels; both images divided by their own coverage, then cut out as comparison.silhouette says",
                "background": "comparison.background in both images, after encoding",
                "clipping": "before encoding",
                "roughness": f"mean squared error of perceptual roughness over whole images, {grey}",
            }
        if self.comparison != ComparisonSettings():
            known["comparison"] = asdict(self.comparison)
        return {
            **known,
            "label": self.label,
            "ssim": {**ssim, "window": self.ssim.window, "data_range": 1.0, "sample_covariance": False},
            "lpips": {**asdict(self.lpips), "version": "0.1", "map": "spatial, averaged over scored pixels"},
            "reference_renderer": {
                "name": REFERENCE,
                "shadows": "traced",
                "bounces": REFERENCE_BOUNCES,
                "atlas": REFERENCE_ATLAS,
                "coat": "layered",
                "light_rows": REFERENCE_LIGHT_ROWS,
            },
            "value_range": [0.0, 1.0],
            "clipping": "after encoding; clipped values are counted",
            "alignment_space": "linear, over all scored pixels of the test set",
            "mask_rule": "true coverage above mask_threshold; both images divided by their own coverage",
            "background": "white in both images, after encoding",
            "whole_image": "PSNR over all pixels, both images laid over the background by their own coverage",
            "roughness": "mean squared error of perceptual roughness, not encoded, not clipped",
            "reduction": "per image, then mean over images; views without a scored pixel are left out and counted",
            **rules,
        }


@cache
def shipped(name: str) -> Protocol:
    """The protocol that ``conf/protocol/NAME.yaml`` describes, paper-v3 where there is no such file."""
    path = conf_folder() / "protocol" / f"{name}.yaml"
    return parsed(Protocol, read_yaml(path)) if is_file(path) else Protocol()
