"""The scoring protocol: every definition that decides a number, as one named object that is stored with the numbers.

``docs/protocol.md`` says the same in words, with the reasons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.render.settings import REFERENCE, REFERENCE_ATLAS, REFERENCE_BOUNCES, REFERENCE_LIGHT_ROWS

Encoding = Literal["srgb", "linear"]
AlignmentName = Literal["mean_rgb", "per_channel", "least_squares"]
LpipsNet = Literal["alex", "vgg", "squeeze"]
Count = Annotated[int, Field(ge=1, le=2**16)]  # points or samples: more would never end


@dataclass(frozen=True)
class SsimSettings:
    """Structural similarity (Wang et al. 2004) as scikit-image computes it, with a Gaussian window.

    ``sigma`` is the window's standard deviation in pixels; 11 x 11 pixels by default.
    """

    TRUNCATE: ClassVar[float] = 3.5  # where the window is cut off, in sigma

    sigma: Annotated[float, Field(gt=0)] = 1.5

    @property
    def window(self) -> int:
        """Width of the window in pixels (scikit-image's rule)."""
        return 2 * int(self.TRUNCATE * self.sigma + 0.5) + 1


@dataclass(frozen=True)
class LpipsSettings:
    """LPIPS 0.1 (Zhang et al. 2018) with the backbone ``net``.

    ``weights`` names a safetensors file with the full state dict of that network; None takes the package's own for
    "squeeze", and lets the ``lpips`` package download the others.
    """

    net: LpipsNet = "squeeze"
    weights: str | None = None

    def __post_init__(self) -> None:
        """Raise InputError for a weights file that is not there."""
        if self.weights is not None and not Path(self.weights).is_file():
            raise InputError(f"protocol.lpips.weights: expected an existing safetensors file, found {self.weights!r}")


@dataclass(frozen=True)
class Protocol:
    """How a reconstruction becomes numbers. The defaults are the protocol ``paper-v2``.

    Attributes:
        name: Put before everything else in the label.
        version: Of the definitions in this package, the only ones that this code computes; raised whenever one changes a number.
        albedo_encoding: What albedo is compared in, after clipping to [0, 1].
        radiance_encoding: The same for rendered images.
        alignment: How the one free scale of an albedo is fixed, always in linear values and over the whole test set.
        mask_threshold: Pixels whose true coverage is above it are scored.
        map_points: Points along a side of a pixel of an albedo or roughness map.
        render_points: Points along a side of a pixel of a view-synthesis or relighting render.
        samples_per_pixel: Directions of light that a pixel of such a render adds up.
        curve_stride: The curve during a run looks at every such view ...
        curve_samples: ... with at most so many samples a pixel.
        seed: Of the directions; the same for every run, whatever its own seed.
    """

    name: str = "paper-v2"
    version: Literal[2] = 2
    albedo_encoding: Encoding = "srgb"
    radiance_encoding: Encoding = "srgb"
    alignment: AlignmentName = "mean_rgb"
    mask_threshold: Annotated[float, Field(ge=0, lt=1)] = 0.5
    map_points: Count = 8
    render_points: Count = 4
    samples_per_pixel: Count = 128
    curve_stride: Count = 4
    curve_samples: Count = 32
    seed: Annotated[int, Field(ge=0)] = 0
    ssim: SsimSettings = field(default_factory=SsimSettings)
    lpips: LpipsSettings = field(default_factory=LpipsSettings)

    @property
    def label(self) -> str:
        """The name, the LPIPS net, and everything else that differs from the default: numbers compare under one label.

        >>> Protocol(samples_per_pixel=64).label
        'paper-v2 (lpips.net=squeeze, samples_per_pixel=64)'
        """
        default, mine = _flat(asdict(Protocol())), _flat(asdict(self))
        decisive = [key for key in mine if key not in ("name", "lpips.weights")]  # where weights lie decides nothing
        changed = [f"{key}={mine[key]}" for key in decisive if mine[key] != default[key] and key != "lpips.net"]
        return f"{self.name} ({', '.join([f'lpips.net={self.lpips.net}', *changed])})"

    def describe(self) -> dict[str, Any]:
        """Everything that decides the numbers, settings and fixed rules alike, for storing beside them (JSON types)."""
        return {
            **asdict(self),
            "label": self.label,
            "ssim": {**asdict(self.ssim), "window": self.ssim.window, "data_range": 1.0, "sample_covariance": False},
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
        }


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Turn ``{"a": {"b": 1}}`` into ``{"a.b": 1}``."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        flat.update(_flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value})
    return flat
