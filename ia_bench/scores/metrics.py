"""The metrics: functions of two pictures as a protocol compares them.

A new metric is a function, and one line in :data:`METRICS`: it is then computed, recorded, tabulated and drawn.
"""

from __future__ import annotations

import functools
import socket
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ia_bench.common.errors import InputError, first_line
from ia_bench.common.paths import PACKAGE
from ia_bench.common.registry import process_state_kept
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores.protocol import LpipsSettings, Protocol, SsimSettings

if TYPE_CHECKING:
    import lpips as lpips_package
    from torch import Tensor

C1, C2 = 0.01**2, 0.03**2  # of SSIM, for a data range of 1
LEAST = 0.1  # of the noise that stays as an error: with less, chance would decide


class Undefined(Exception):
    """A number that does not exist for this input; the message is the reason that is stored beside the null."""


class NoScoredPixel(Undefined):
    """The mask is empty: there is nothing to compare, whatever the prediction."""

    def __init__(self) -> None:
        """Carry the one reason there is."""
        super().__init__("no scored pixel")


@dataclass(frozen=True)
class Compared:
    """Two pictures of one view as they are compared (:mod:`ia_bench.scores.comparison` makes them).

    Attributes:
        predicted: (H, W, 3), or (H, W) of roughness, encoded and clipped.
        true: The same of the truth.
        area: (H, W) bool, the pixels that means are taken over.
        protocol: Its settings of SSIM and LPIPS are read.
        whole: Whether the pictures are compared as whole images. If not, both are white outside of ``area``, so that windows
            that reach over its edge find the same there.
        grey: The picture whose PSNR is the least that counts, None for no such floor.
        clipped: How many values of scored pixels were clipped, in prediction and truth.
        spread: Half the difference of two estimates of the prediction, (H, W, 3), as it is compared; None of what has no noise. The
            mean of its square is the noise's part of the squared error, without bias.
        parts: The parts of the squared error, by their names (:mod:`ia_bench.scores.error_split`); nothing where it is not split.
    """

    predicted: np.ndarray
    true: np.ndarray
    area: np.ndarray
    protocol: Protocol = field(default_factory=Protocol)
    whole: bool = False
    grey: np.ndarray | None = None
    clipped: tuple[int, int] = (0, 0)
    spread: np.ndarray | None = None
    parts: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of_object(
        cls,
        predicted: np.ndarray,
        true: np.ndarray,
        mask: np.ndarray,
        protocol: Protocol | None = None,
        clipped: tuple[int, int] = (0, 0),
        spread: np.ndarray | None = None,
    ) -> Compared:
        """Compare the pixels of ``mask`` (H, W) alone: everything else is painted white in both pictures (H, W, 3)."""
        inside = mask[..., None]
        pair = np.where(inside, predicted, 1.0), np.where(inside, true, 1.0)
        spread = None if spread is None else np.where(inside, spread, 0.0)
        return cls(*pair, mask, protocol or Protocol(), clipped=clipped, spread=spread)


def squared_error(pair: Compared) -> float:
    """Mean of (predicted - true)^2 over the area's pixels and channels. Raises NoScoredPixel on an empty area."""
    if not pair.area.any():
        raise NoScoredPixel
    predicted, true = (picture[pair.area].astype(np.float64) for picture in (pair.predicted, pair.true))
    return float(np.square(predicted - true).mean())


def root_squared_error(pair: Compared) -> float:
    """The square root of :func:`squared_error`, in the pictures' own unit."""
    return float(np.sqrt(squared_error(pair)))


def psnr(pair: Compared) -> float:
    """Peak signal-to-noise ratio -10 log10(MSE) in dB, peak 1; +inf for pictures that are identical in the area.

    It is no less than that of ``pair.grey``, where the protocol has such a floor. Where the prediction has a ``spread``, the noise
    is subtracted from the error, of which at least LEAST of the noise is left. Raises NoScoredPixel on an empty area.
    """
    error = without_noise(pair)[0]
    if pair.grey is not None:
        error = min(error, squared_error(replace(pair, predicted=pair.grey)))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def part_of_error(pair: Compared, name: str) -> float:
    """One of ERROR_PARTS, a mean over the area's pixels and channels, times 1000; "total" is their sum."""
    return 1000 * (sum(pair.parts.values()) if name == "total" else pair.parts[name])


def without_noise(pair: Compared) -> tuple[float, bool]:
    """The squared error less the part of the noise, an unbiased estimate, and whether it had to be cut at LEAST of the noise."""
    error = squared_error(pair)
    if pair.spread is None:
        return error, False
    noise = float(np.square(pair.spread[pair.area]).mean())
    return max(error - noise, LEAST * noise), error - noise < LEAST * noise


def ssim(pair: Compared) -> float:
    """Structural similarity (Wang et al. 2004), the mean of its map over pixels and channels.

    The pixels are those of the area; of whole images all, or all whose window lies within the picture (``ssim.border=valid``). As
    scikit-image computes it with a Gaussian window and population covariance, with all channels in one filter: at the size of
    our images its calls for each moment and channel take longer than their arithmetic.

    Raises Undefined on pictures smaller than the window, NoScoredPixel on an empty area.
    """
    settings, (height, width) = pair.protocol.ssim, pair.area.shape
    if not pair.area.any():
        raise NoScoredPixel
    if min(height, width) < settings.window:
        raise Undefined(f"image of {width} x {height} pixels is smaller than the window of {settings.window}")
    if pair.whole:
        border = settings.window // 2 if settings.border == "valid" else 0
        found = _similarity(pair.predicted, pair.true, pair.spread, settings)
        within = slice(border, height - border), slice(border, width - border)
        if not (known := pair.area[within]).any():
            raise Undefined("no known pixel has its window within the picture")
        return float(found[within][known].mean())
    reach, places = settings.window, np.nonzero(pair.area)  # no window of a scored pixel looks farther
    seen = tuple(slice(max(int(at.min()) - reach, 0), int(at.max()) + reach + 1) for at in places)
    spread = None if pair.spread is None else pair.spread[seen]
    return float(_similarity(pair.predicted[seen], pair.true[seen], spread, settings)[pair.area[seen]].mean())


def _similarity(predicted: np.ndarray, true: np.ndarray, spread: np.ndarray | None, settings: SsimSettings) -> np.ndarray:
    """The SSIM map (H, W, 3) of two images (H, W, 3), which are mirrored at their borders; less the variance of a ``spread``."""
    from scipy.ndimage import gaussian_filter  # only the scores of a whole run need it

    x, y = (image.astype(np.float64) for image in (predicted, true))
    reach = settings.window // 2
    blur = partial(gaussian_filter, sigma=(0, settings.sigma, settings.sigma, 0), radius=(0, reach, reach, 0))
    noise = 0.0 if spread is None else np.square(spread)
    mean_x, mean_y, xx, yy, xy = blur(np.stack([x, y, x * x - noise, y * y, x * y]))
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    variances = xx - mean_x**2 + yy - mean_y**2
    structure = (2 * (xy - mean_x * mean_y) + C2) / ((variances if spread is None else variances.clip(0)) + C2)
    return luminance * structure


SHIPPED = {"squeeze": PACKAGE / "scores" / "weights" / "lpips_squeeze.safetensors"}  # networks that need no download
SMALLEST = 32  # pixels; AlexNet's deepest features vanish below 31
DOWNLOAD_SECONDS = 10.0  # of silence before a download is given up


def lpips(pair: Compared) -> float:
    """LPIPS (Zhang et al. 2018): the network's own ``spatial`` map, averaged over the area's pixels.

    The map is the sum of each layer's distance, bilinearly enlarged to the picture. Of whole images it is taken as its authors
    do: every layer's distance averaged over its own pixels, and summed; ``comparison.lpips_encoded_again`` encodes both before.

    Raises NoScoredPixel on an empty area, and Undefined for pictures below 32 pixels, or where the package or its weights are
    not to be had.
    """
    if not pair.area.any():
        raise NoScoredPixel
    settings, pictures = pair.protocol.lpips, (pair.predicted, pair.true)
    if pair.protocol.comparison.lpips_encoded_again:  # of whole images alone
        pictures = linear_to_srgb(pair.predicted), linear_to_srgb(pair.true)
    layers = layer_distances(*pictures, settings)
    if pair.whole:
        return sum(float(layer.mean()) for layer in layers)
    from torch.nn.functional import interpolate

    enlarged = [interpolate(layer, pair.area.shape, mode="bilinear", align_corners=False) for layer in layers]
    return float(sum(enlarged[1:], enlarged[0]).numpy()[0, 0][pair.area].mean(dtype=np.float64))


def layer_distances(predicted: np.ndarray, true: np.ndarray, settings: LpipsSettings) -> list[Tensor]:
    """The distances (1, 1, h, w) of two pictures (H, W, 3) in each layer of the network; both go through it in one batch."""
    if min(predicted.shape[:2]) < SMALLEST:
        raise Undefined(f"image of {predicted.shape[1]} x {predicted.shape[0]} pixels is smaller than {SMALLEST}")
    network = load(settings)
    if isinstance(network, str):
        raise Undefined(network)

    import torch
    from lpips import normalize_tensor

    batch = torch.from_numpy(np.stack([predicted, true]).astype(np.float32)).permute(0, 3, 1, 2)
    with process_state_kept(), torch.inference_mode():
        torch.set_num_threads(1)  # on a busy machine, threads of a small network that wait for each other cost a hundred times more
        layers = zip(network.lins, network.net(network.scaling_layer(2 * batch - 1)), strict=True)
        pairs = ((head, *normalize_tensor(features).split(1)) for head, features in layers)
        return [head((one - other) ** 2) for head, one, other in pairs]


def check_weights(settings: LpipsSettings) -> None:
    """Raise InputError where ``settings`` names a file that cannot be used: before a fit, whose scores would find out."""
    if settings.weights is not None and not Path(settings.weights).is_file():
        raise InputError(f"protocol.lpips.weights: expected an existing safetensors file, found {settings.weights!r}")
    if settings.weights is not None and isinstance(network := load(settings), str):
        raise InputError(f"protocol.lpips.weights: {network}")


@functools.cache
def load(settings: LpipsSettings) -> lpips_package.LPIPS | str:
    """Return the network, or the reason why there is none. Tried once per process, for a failed download is slow."""
    try:
        from ia_bench.common.torchvision_shim import import_torchvision

        import_torchvision()
        import lpips as package
        import torch
    except Exception as error:  # a broken installation raises anything, and costs this one metric only
        return f"the lpips package cannot be imported: {first_line(error)}"
    weights = settings.weights or SHIPPED.get(settings.net)
    own = weights is None
    try:
        # Random weights are drawn before ours are read; torch.hub chats on stdout, warns, and waits for minutes.
        with process_state_kept(), redirect_stdout(sys.stderr), warnings.catch_warnings(), ExitStack() as afterwards:
            warnings.simplefilter("ignore", UserWarning)
            afterwards.callback(socket.setdefaulttimeout, socket.getdefaulttimeout())
            socket.setdefaulttimeout(DOWNLOAD_SECONDS)
            network = package.LPIPS(net=settings.net, spatial=True, pnet_rand=not own, pretrained=own, verbose=False)
    except Exception as error:  # no connection, a download that does not match its checksum, a damaged file in the cache
        return f"weights of lpips net {settings.net} can be neither read nor downloaded: {first_line(error)}"
    if weights is not None:
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        try:
            network.load_state_dict(load_file(weights), strict=True)
        except (OSError, RuntimeError, SafetensorError) as error:
            return f"{weights} is no full state dict of lpips net {settings.net}: {first_line(error)}"
    if not all(bool(torch.isfinite(values).all()) for values in network.state_dict().values()):
        return f"weights of lpips net {settings.net} hold NaN or infinity"
    return network.to(memory_format=torch.channels_last).eval().requires_grad_(False)


# ---- the metrics as data: scores, tables and figures follow it ----


@dataclass(frozen=True)
class Metric:
    """One column.

    Attributes:
        component: What is measured, as in metrics.json: "albedo", "aligned_albedo", "view_synthesis", "relighting", "roughness",
            "metallic", "light" (by balls under it), "log_light", "albedo_error".
        name: The metric's own, as in metrics.json.
        of: Two pictures of one view -> a number. Raises Undefined where there is none.
        group: The component as the paper prints it.
        label: The name as the paper prints it.
        higher_is_better: Whether larger values are.
        digits: Places after the point that are printed.
        on_curve: Whether it is measured during a run, for curve.csv.
    """

    component: str
    name: str
    of: Callable[[Compared], float]
    group: str
    label: str
    higher_is_better: bool
    digits: int
    on_curve: bool = False

    @property
    def key(self) -> str:
        """``component.name``, as in the reasons of metrics.json."""
        return f"{self.component}.{self.name}"

    @property
    def column(self) -> str:
        """``component_name``, as in curve.csv and in the paper's CSV."""
        return f"{self.component}_{self.name}"

    @property
    def arrow(self) -> str:
        """The arrow that points to better."""
        return "↑" if self.higher_is_better else "↓"

    @property
    def title(self) -> str:
        """Group, label and arrow, for example "Albedo PSNR ↑"."""
        return f"{self.group} {self.label} {self.arrow}"

    def text(self, value: float) -> str:
        """The value with the metric's number of digits."""
        return f"{value:.{self.digits}f}"


def _image_metrics(component: str, group: str) -> tuple[Metric, ...]:
    return (
        Metric(component, "psnr", psnr, group, "PSNR", higher_is_better=True, digits=2, on_curve=True),
        Metric(component, "ssim", ssim, group, "SSIM", higher_is_better=True, digits=4),
        Metric(component, "lpips", lpips, group, "LPIPS", higher_is_better=False, digits=4),
    )


ERROR_PARTS = {"level": "level, cast", "low": "low frequency", "high": "high frequency", "unseen": "unseen"}
WHERE = "Where the error sits"  # what the squared error of the albedo is split into, and how it is printed

METRICS = (
    *_image_metrics("albedo", "Albedo"),
    *_image_metrics("aligned_albedo", "Aligned albedo"),
    *_image_metrics("view_synthesis", "View synthesis"),
    *_image_metrics("relighting", "Relighting"),
    Metric("roughness", "mse", squared_error, "Roughness", "MSE", higher_is_better=False, digits=4, on_curve=True),
)
"""The columns of the paper's table."""

MEASURED = (
    *METRICS,
    Metric("metallic", "mse", squared_error, "Metallic", "MSE", higher_is_better=False, digits=4),
    Metric("light", "psnr", psnr, "Light", "PSNR", higher_is_better=True, digits=2),
    Metric("log_light", "rmse", root_squared_error, "Light", "log RMSE", higher_is_better=False, digits=3),
    *(
        Metric("albedo_error", name, partial(part_of_error, name=name), WHERE, label, higher_is_better=False, digits=2)
        for name, label in ({"total": "1000 MSE"} | ERROR_PARTS).items()
    ),
)
"""These, and what stands in metrics.json alone."""

COMPONENTS = tuple(dict.fromkeys(metric.component for metric in MEASURED))
CURVE_METRICS = tuple(metric for metric in METRICS if metric.on_curve)  # the columns of curve.csv
METRIC_OF = {metric.key: metric for metric in MEASURED}
