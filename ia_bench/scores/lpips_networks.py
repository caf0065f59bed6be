"""The networks of LPIPS 0.1 (Zhang et al. 2018): those of the ``lpips`` package, and its SqueezeNet without that package."""

from __future__ import annotations

import socket
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d

from ia_bench.common.errors import first_line
from ia_bench.common.registry import process_state_kept
from ia_bench.scores.protocol import LpipsSettings

if TYPE_CHECKING:
    from lpips import LPIPS

DOWNLOAD_SECONDS = 10.0  # of silence before a download is given up
FIRES = ((3, 4), (6, 7), (9,), (10,), (11,), (12,))  # the modules of SqueezeNet that end in a layer, after the first layer
POOLED = 3  # of these groups begin with a pooling


def of_package(settings: LpipsSettings, *, own: bool) -> LPIPS | str:
    """The network as the ``lpips`` package makes it, with its ``own`` weights or random ones; or why there is none."""
    try:
        from ia_bench.common.torchvision_shim import import_torchvision

        import_torchvision()
        import lpips as package
    except Exception as error:  # a broken installation raises anything, and costs this one metric only
        return f"the lpips package cannot be imported: {first_line(error)}"
    try:
        # Random weights are drawn before ours are read; torch.hub chats on stdout, warns, and waits for minutes.
        with process_state_kept(), redirect_stdout(sys.stderr), warnings.catch_warnings(), ExitStack() as afterwards:
            warnings.simplefilter("ignore", UserWarning)
            afterwards.callback(socket.setdefaulttimeout, socket.getdefaulttimeout())
            socket.setdefaulttimeout(DOWNLOAD_SECONDS)
            network = package.LPIPS(net=settings.net, spatial=True, pnet_rand=not own, pretrained=own, verbose=False)
    except (OSError, RuntimeError) as error:  # no connection; a download that does not match its checksum
        return f"weights of lpips net {settings.net} are not cached and cannot be downloaded: {first_line(error)}"
    return network.to(memory_format=torch.channels_last).eval().requires_grad_(False)


class SqueezeLpips:
    """LPIPS on SqueezeNet 1.1 (Iandola et al. 2016); its parts have the names of those of ``lpips.LPIPS``.

    It equals that, which takes as long to import, with torchvision, as forty pictures take to be scored.

    Attributes:
        lins: Of each of the seven layers, squared differences of features (N, C, h, w) -> their weighted sum (N, 1, h, w).
    """

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        """``weights``: the state dict of ``lpips.LPIPS(net="squeeze")``. Raises RuntimeError where one is missing."""
        kernels = torch.channels_last
        self._weights = {name: v.contiguous(memory_format=kernels) if v.ndim == 4 else v for name, v in weights.items()}
        try:
            self.lins: list[Callable[[Tensor], Tensor]] = [
                partial(conv2d, weight=self._weights[f"lins.{layer}.model.1.weight"]) for layer in range(len(FIRES) + 1)
            ]
            with torch.inference_mode():
                self.net(self.scaling_layer(torch.zeros(1, 3, 32, 32)))
        except KeyError as error:
            raise RuntimeError(f"expected {error}, found none") from error

    def scaling_layer(self, images: Tensor) -> Tensor:
        """(N, 3, H, W) in [-1, 1] as the network wants them."""
        return (images - self._weights["scaling_layer.shift"]) / self._weights["scaling_layer.scale"]

    def net(self, images: Tensor) -> list[Tensor]:
        """The features (N, C, h, w) of the seven layers."""
        features = [self._convolved(images, "net.slice1.0", stride=2)]
        for group, fires in enumerate(FIRES):
            values = max_pool2d(features[-1], 3, 2, ceil_mode=True) if group < POOLED else features[-1]
            for fire in (f"net.slice{group + 2}.{fire}" for fire in fires):
                squeezed = self._convolved(values, f"{fire}.squeeze")
                wide = self._convolved(squeezed, f"{fire}.expand1x1"), self._convolved(squeezed, f"{fire}.expand3x3", padding=1)
                values = torch.cat(wide, 1)
            features.append(values)
        return features

    def _convolved(self, images: Tensor, name: str, *, stride: int = 1, padding: int = 0) -> Tensor:
        return conv2d(images, self._weights[f"{name}.weight"], self._weights[f"{name}.bias"], stride, padding).relu_()
