"""The scoring protocol: every definition that decides a number, as one named object that is stored with the numbers.

``docs/protocol.md`` says the same in words, with the reasons.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

from ia_bench.render.settings import REFERENCE, REFERENCE_ATLAS, REFERENCE_BOUNCES, REFERENCE_LIGHT_ROWS

Encoding = Literal["srgb", "linear"]
AlignmentName = Literal["mean_rgb", "per_channel", "least_squares"]
LpipsNet = Literal["alex", "vgg", "squeeze"]
MOST = 2**16  # points or samples: more would never end


class ProtocolError(ValueError):
    """A protocol setting that does not exist, or a value that it cannot take."""


@dataclass(frozen=True)
class SsimSettings:
    """Structural similarity (Wang et al. 2004) as scikit-image computes it, with a Gaussian window.

    ``sigma`` is the window's standard deviation in pixels; it is cut off at 3.5 sigma, 11 x 11 pixels by default.
    """

    sigma: float = 1.5

    def __post_init__(self) -> None:
        """Raise :class:`ProtocolError` unless ``sigma`` is positive."""
        _expect(self.sigma > 0, "ssim.sigma", "a positive number of pixels", self.sigma)

    @property
    def window(self) -> int:
        """Width of the window in pixels (scikit-image's rule)."""
        return 2 * int(3.5 * self.sigma + 0.5) + 1


@dataclass(frozen=True)
class LpipsSettings:
    """LPIPS 0.1 (Zhang et al. 2018) with the backbone ``net``.

    ``weights`` names a safetensors file with the full state dict of that network; None takes the package's own for
    "squeeze", and lets the ``lpips`` package download the others.
    """

    net: LpipsNet = "squeeze"
    weights: str | None = None

    def __post_init__(self) -> None:
        """Raise :class:`ProtocolError` for an unknown network or a weights file that is not there."""
        _expect_one_of(get_args(LpipsNet), "lpips.net", self.net)
        if self.weights is not None:
            _expect(Path(self.weights).is_file(), "lpips.weights", "an existing safetensors file", self.weights)


@dataclass(frozen=True)
class Protocol:
    """How a reconstruction becomes numbers. The defaults are the protocol ``paper-v2``.

    Attributes:
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
    albedo_encoding: Encoding = "srgb"
    radiance_encoding: Encoding = "srgb"
    alignment: AlignmentName = "mean_rgb"
    mask_threshold: float = 0.5
    map_points: int = 8
    render_points: int = 4
    samples_per_pixel: int = 128
    curve_stride: int = 4
    curve_samples: int = 32
    seed: int = 0
    ssim: SsimSettings = field(default_factory=SsimSettings)
    lpips: LpipsSettings = field(default_factory=LpipsSettings)

    VERSION = 2  # of the definitions in this package; raised whenever one changes a number

    def __post_init__(self) -> None:
        """Raise :class:`ProtocolError` for a value that the definition does not know."""
        _expect_one_of(get_args(Encoding), "albedo_encoding", self.albedo_encoding)
        _expect_one_of(get_args(Encoding), "radiance_encoding", self.radiance_encoding)
        _expect_one_of(get_args(AlignmentName), "alignment", self.alignment)
        _expect(0 <= self.mask_threshold < 1, "mask_threshold", "a coverage in [0, 1)", self.mask_threshold)
        for key in ("map_points", "render_points", "samples_per_pixel", "curve_stride", "curve_samples"):
            _expect(1 <= getattr(self, key) <= MOST, key, f"at least 1 and at most {MOST}", getattr(self, key))
        _expect(self.seed >= 0, "seed", "at least 0", self.seed)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Protocol:
        """Read a nested mapping such as ``{"name": "paper-v2", "lpips": {"net": "vgg"}}``.

        Keys that are absent keep the default. ``version``, where given, has to be the one that this code computes.
        Raises :class:`ProtocolError` naming an unknown key and the nearest known one, or a value of the wrong type.
        """
        config = dict(config)
        version = config.pop("version", cls.VERSION)
        _expect(version == cls.VERSION, "version", f"{cls.VERSION}, the only version this code computes", version)
        return _build(cls, config, "")

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
            "version": self.VERSION,
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


def _build(cls: type, config: Mapping[str, Any], prefix: str) -> Any:  # noqa: ANN401 (an instance of cls)
    """Build one settings class from a mapping, checking every key and type."""
    known = [f.name for f in fields(cls)]
    hints = get_type_hints(cls)
    values = {}
    for key, value in config.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"; did you mean {prefix}{near[0]}?" if near else f"; known are {', '.join(known)}"
            raise ProtocolError(f"protocol.{prefix}{key}: no such setting{hint}")
        if isinstance(value, Mapping) and hasattr(hints[key], "__dataclass_fields__"):
            values[key] = _build(hints[key], value, f"{prefix}{key}.")
        else:
            values[key] = _checked(value, hints[key], f"{prefix}{key}")
    return cls(**values)


def _checked(value: Any, kind: Any, key: str) -> Any:  # noqa: ANN401 (configuration values are of any type)
    """Return ``value`` as the annotated type; Literals are left to ``__post_init__``, which names the choices."""
    if kind is float:
        _expect(isinstance(value, int | float) and not isinstance(value, bool), key, "a number", value)
        return float(value)
    if kind is int:
        _expect(isinstance(value, int) and not isinstance(value, bool), key, "an integer", value)
    elif kind is str:
        _expect(isinstance(value, str), key, "a text", value)
    elif kind == str | None:
        _expect(value is None or isinstance(value, str), key, "a text or null", value)
    elif hasattr(kind, "__dataclass_fields__"):
        _expect(isinstance(value, kind), key, f"a group of settings ({', '.join(f.name for f in fields(kind))})", value)
    return value


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Turn ``{"a": {"b": 1}}`` into ``{"a.b": 1}``."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        flat.update(_flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value})
    return flat


def _expect(condition: bool, key: str, expected: str, found: object) -> None:
    if not condition:
        raise ProtocolError(f"protocol.{key}: expected {expected}, found {found!r}")


def _expect_one_of(choices: tuple[str, ...], key: str, found: object) -> None:
    if found not in choices:
        near = difflib.get_close_matches(str(found), choices, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise ProtocolError(f"protocol.{key}: expected one of {', '.join(choices)}, found {found!r}{hint}")
