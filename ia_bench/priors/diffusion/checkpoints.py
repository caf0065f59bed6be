"""Trained networks on disk, in files that the ``diffusers`` ecosystem reads.

A folder of weights holds ``prior.json`` (the network's config, and where the weights come from), the noise schedule as
diffusers writes it (``scheduler/scheduler_config.json``), the UNet likewise (``unet/config.json`` and
``unet/diffusion_pytorch_model.safetensors``), ``head.safetensors`` (the convolutions at full resolution) and
``encoder.safetensors`` (the image encoder).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench.priors.weight_files import content_hash, fill, read_description, save_weights

DESCRIPTION = "prior.json"
UNET = "unet/diffusion_pytorch_model.safetensors"
HEAD = "head.safetensors"
ENCODER = "encoder.safetensors"


def save_network(folder: Path, network: MaterialNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder``, in half precision; see :func:`ia_bench.priors.weight_files.save_weights`."""
    import_torchvision()
    from diffusers import DDPMScheduler

    def save_configs(partial: Path) -> None:
        network.unet.save_config(partial / "unet")
        if network.config.kind == "diffusion":
            DDPMScheduler(**network.config.schedule, prediction_type="sample").save_config(partial / "scheduler")

    save_weights(folder, DESCRIPTION, network.config, _modules(network), provenance, save_configs)


def load_network(folder: Path) -> tuple[MaterialNetwork, dict[str, Any]]:
    """Load the network in ``folder``, in float32 and evaluation mode, and its provenance.

    Raises InputError, naming file and key, for what is missing, damaged or does not fit its config.
    """
    config, provenance = read_description(folder / DESCRIPTION, NetworkConfig)
    network = MaterialNetwork(config)
    for name, module in _modules(network).items():
        fill(module, folder / name)
    return network.eval().requires_grad_(False), provenance


def fingerprint(folder: Path) -> str:
    """SHA-256 over the files that determine the network's output."""
    return content_hash(folder / name for name in (DESCRIPTION, UNET, HEAD, ENCODER))


def _modules(network: MaterialNetwork) -> dict[str, torch.nn.Module]:
    """The parts of a network, by the file that holds them."""
    parts = {UNET: network.unet, HEAD: network.head, ENCODER: network.encoder}
    return {name: module for name, module in parts.items() if module is not None}
