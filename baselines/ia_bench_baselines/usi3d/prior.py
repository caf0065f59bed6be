"""The prior `usi3d`: the albedo of one picture by the unpaired translation of Liu et al. 2020 (:mod:`.networks`)."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from torch import Tensor, nn

from ia_bench.priors.contract import PriorInfo
from ia_bench_baselines.common.pictures import PicturePrior
from ia_bench_baselines.usi3d.networks import AlbedoPath

WEIGHTS = "9dacbfb1ce7a8d60dd611ab0d31a497f78489b3dc65d17e691aa8383785b6a91"
"""SHA-256 of the packaged weights. A run is known by its prior's code, so that runs with other weights are other runs."""


class Usi3dPrior(PicturePrior):
    """Deterministic: one albedo an image, without specular shading. Its scale is arbitrary, its brightest paints are white.

    ``weights``: a file that ``ia_bench_baselines.usi3d.train`` wrote, None for the packaged one.
    """

    kind = "usi3d"
    info = PriorInfo(provides=frozenset({"albedo"}), resolution=64)

    @staticmethod
    def packaged() -> Path:
        """Beside this module."""
        return Path(str(files("ia_bench_baselines.usi3d") / "weights" / "usi3d.safetensors"))

    @staticmethod
    def make_network() -> nn.Module:
        """From an image to its albedo."""
        return AlbedoPath()

    def predict(self, network: nn.Module, picture: Tensor) -> dict[str, Tensor]:
        """The translation as it is, from [-1, 1] to [0, 1]."""
        return {"albedo": 0.5 + 0.5 * network(picture)}
