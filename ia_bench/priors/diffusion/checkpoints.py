"""Trained networks on disk, in files that cannot run code and that the ``diffusers`` ecosystem reads.

A folder of weights holds ``prior.json`` (the network's config, and where the weights come from), the noise schedule as
diffusers writes it (``scheduler/scheduler_config.json``), the UNet likewise (``unet/config.json`` and
``unet/diffusion_pytorch_model.safetensors``), ``head.safetensors`` (the convolutions at full resolution) and
``encoder.safetensors`` (the image encoder).
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.settings import parsed
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench.priors.weight_files import content_hash, fill

FORMAT = 1
UNET = "unet/diffusion_pytorch_model.safetensors"
HEAD = "head.safetensors"
ENCODER = "encoder.safetensors"


def save_network(folder: Path, network: MaterialNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder``, in half precision; an older version there is replaced whole.

    ``provenance``: data, steps, seconds, machine, figures (JSON values), kept beside the config.
    """
    import_torchvision()
    from diffusers import DDPMScheduler

    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    (partial / "unet").mkdir()
    network.unet.save_config(partial / "unet")
    for name, module in _modules(network).items():
        save_file({key: value.half().contiguous() for key, value in module.state_dict().items()}, partial / name)
    config = network.config
    if config.kind == "diffusion":
        DDPMScheduler(**config.schedule, prediction_type="sample").save_config(partial / "scheduler")
    described = {"format": FORMAT, "network": dataclasses.asdict(config), "provenance": provenance}
    (partial / "prior.json").write_text(json.dumps(described, indent=2) + "\n")
    old = folder.with_name(f".{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        os.replace(folder, old)
    os.replace(partial, folder)
    shutil.rmtree(old, ignore_errors=True)


def load_network(folder: Path) -> tuple[MaterialNetwork, dict[str, Any]]:
    """Load the network in ``folder``, in float32 and evaluation mode, and its provenance.

    Raises InputError, naming file and key, for what is missing, damaged or does not fit its config.
    """
    network = MaterialNetwork(read_config(folder))
    for name, module in _modules(network).items():
        fill(module, folder / name, module.state_dict())
    network.eval().requires_grad_(False)
    provenance: dict[str, Any] = read_description(folder)["provenance"]
    return network, provenance


def read_description(folder: Path) -> dict[str, Any]:
    """What ``prior.json`` says. Raises InputError where there is none or one of another format."""
    path = folder / "prior.json"
    if not is_file(path):
        raise InputError(f"{path}: no such file; expected a folder of weights written by ia_bench_training.train")
    described = read_json(path)
    if described.get("format") != FORMAT:
        raise InputError(f"{path}: format: expected {FORMAT}, found {described.get('format')}")
    for key in ("network", "provenance"):
        if not isinstance(described.get(key), dict):
            raise InputError(f"{path}: expected a table under {key!r}, found {described.get(key)!r}")
    return described


def read_config(folder: Path) -> NetworkConfig:
    """The network that ``prior.json`` describes. Raises InputError, naming file and key, for what describes none."""
    path = folder / "prior.json"
    values = read_description(folder)["network"]
    missing = next((one.name for one in dataclasses.fields(NetworkConfig) if one.name not in values), None)
    if missing is not None:
        raise InputError(f"{path}: network.{missing}: expected a value, found no such key")
    try:
        return parsed(NetworkConfig, values, "network")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def fingerprint(folder: Path) -> str:
    """SHA-256 over the files that determine the network's output."""
    return content_hash(folder / name for name in ("prior.json", UNET, HEAD, ENCODER))


def _modules(network: MaterialNetwork) -> dict[str, torch.nn.Module]:
    """The parts of a network, by the file that holds them."""
    parts = {UNET: network.unet, HEAD: network.head, ENCODER: network.encoder}
    return {name: module for name, module in parts.items() if module is not None}

