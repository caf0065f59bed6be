"""The prior `yi`: albedo and specular shading of one picture by the networks of Yi et al. 2023 (:mod:`.networks`)."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import torch
from torch import Tensor, nn

from ia_bench.priors.contract import PriorInfo
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench_baselines.common.pictures import PicturePrior
from ia_bench_baselines.yi.networks import InverseRendering

WEIGHTS = "f9013f1d89c62aceaa610183dbca571dc1ca985f893a7d3950f315acb0a93fae"
"""SHA-256 of the packaged weights. A run is known by its prior's code, so that runs with other weights are other runs."""


class YiPrior(PicturePrior):
    """Deterministic. Specular shading first, then the rest's albedo, whose scale nobody knows: its largest value is made 1.

    ``weights``: a file that ``ia_bench_baselines.yi.train`` wrote, None for the packaged one.
    """

    kind = "yi"
    info = PriorInfo(provides=frozenset({"albedo", "specular"}), resolution=64)

    @staticmethod
    def packaged() -> Path:
        """Beside this module."""
        return Path(str(files("ia_bench_baselines.yi") / "weights" / "yi.safetensors"))

    @staticmethod
    def make_network() -> nn.Module:
        """Spec-Net, Normal-Net and Light-Net."""
        return InverseRendering()

    def predict(self, network: nn.Module, picture: Tensor) -> dict[str, Tensor]:
        """Networks work in display values, where I - S is diffuse; in linear ones the specular shading is lin(I) - lin(I - S)."""
        assert isinstance(network, InverseRendering)
        mask = picture[:, 3:]
        image = (0.5 + 0.5 * picture[:, :3]) * (mask > 0)
        diffuse = (image - network.separate(picture)).clamp(0, 1)
        albedo, _, _ = network.decompose(diffuse, mask)
        largest = torch.where(mask > 0.5, albedo, 0.0).amax().clamp_min(1e-6)
        specular = linear_to_srgb(srgb_to_linear(image) - srgb_to_linear(diffuse))
        return {"albedo": (albedo / largest).clamp(0, 1), "specular": specular}
