"""LPIPS of one pair of images inside a mask. torch, torchvision and lpips are imported for the first value only."""

from __future__ import annotations

import contextlib
import functools
import socket
import sys
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ia_bench.common.errors import InputError, first_line
from ia_bench.common.paths import PACKAGE
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined
from ia_bench.scores.protocol import LpipsSettings

if TYPE_CHECKING:
    import lpips as lpips_package
    from torch import Tensor

SHIPPED = {"squeeze": PACKAGE / "scores" / "weights" / "lpips_squeeze.safetensors"}  # networks that need no download
SMALLEST = 32  # pixels; AlexNet's deepest features vanish below 31
DOWNLOAD_SECONDS = 10.0  # of silence before a download is given up; torch.hub itself would wait for minutes


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
    if pair.whole:
        if pair.protocol.comparison.lpips_encoded_again:
            pictures = linear_to_srgb(pair.predicted), linear_to_srgb(pair.true)
        return sum(float(layer.mean()) for layer in layer_distances(*pictures, settings))

    from torch.nn.functional import interpolate

    layers = layer_distances(*pictures, settings)
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
    with torch.inference_mode(), _one_thread():
        layers = zip(network.lins, network.net(network.scaling_layer(2 * batch - 1)), strict=True)
        pairs = ((head, *normalize_tensor(features).split(1)) for head, features in layers)
        return [head((one - other) ** 2) for head, one, other in pairs]


def check_weights(settings: LpipsSettings) -> None:
    """Raise InputError where ``settings`` names a file that cannot be used: before a run, which would find out at its end."""
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
        with torch.random.fork_rng(devices=[]), _quiet_and_impatient():  # random weights are drawn before ours are read
            network = package.LPIPS(net=settings.net, spatial=True, pnet_rand=not own, pretrained=own, verbose=False)
    except (OSError, RuntimeError) as error:  # no connection; a download that does not match its checksum
        return f"weights of lpips net {settings.net} are not cached and cannot be downloaded: {first_line(error)}"
    if weights is not None:
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        try:
            network.load_state_dict(load_file(weights), strict=True)
        except (OSError, RuntimeError, SafetensorError) as error:
            return f"{weights} is no full state dict of lpips net {settings.net}: {first_line(error)}"
    return network.to(memory_format=torch.channels_last).eval().requires_grad_(False)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Run small networks on one thread: on a busy machine, threads waiting for each other cost a hundred times more."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextlib.contextmanager
def _quiet_and_impatient() -> Iterator[None]:
    """Keep torch.hub's chatter off stdout, its deprecation warnings away, and its download from hanging."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(DOWNLOAD_SECONDS)
    try:
        with contextlib.redirect_stdout(sys.stderr), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield
    finally:
        socket.setdefaulttimeout(before)
