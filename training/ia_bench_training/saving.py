"""Weights of networks written to disk, as :mod:`ia_bench.priors.weight_files` reads them."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save_file
from torch import nn

from ia_bench.priors import refiner as refiner_files
from ia_bench.priors.diffusion import network as network_files
from ia_bench.priors.weight_files import FORMAT


def save_weights(
    folder: Path,
    description: str,
    config: Any,  # noqa: ANN401 (a dataclass)
    modules: Mapping[str, nn.Module],
    provenance: Mapping[str, Any],
    more: Callable[[Path], object] = lambda folder: None,
) -> None:
    """Write ``modules``, by the file that holds each, to ``folder``; an older version there is replaced whole.

    ``description``: name of the JSON file with the network's ``config`` and its ``provenance`` (data, steps, seconds, machine,
    figures). ``more`` writes whatever else belongs there, into the folder that it is given.
    """
    partial, old = (folder.with_name(f".{folder.name}.{what}") for what in ("partial", "old"))
    shutil.rmtree(partial, ignore_errors=True)
    for name, module in modules.items():
        (partial / name).parent.mkdir(parents=True, exist_ok=True)
        save_file({key: value.half().contiguous() for key, value in module.state_dict().items()}, partial / name)
    more(partial)
    described = {"format": FORMAT, "network": dataclasses.asdict(config), "provenance": provenance}
    (partial / description).write_text(json.dumps(described, indent=2) + "\n")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        os.replace(folder, old)
    os.replace(partial, folder)
    shutil.rmtree(old, ignore_errors=True)


def save_network(folder: Path, network: network_files.MaterialNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder``, in half precision; see :func:`save_weights`."""
    from diffusers import DDPMScheduler

    def save_configs(partial: Path) -> None:
        network.unet.save_config(partial / "unet")
        if network.config.kind == "diffusion":
            DDPMScheduler(**network.config.schedule, prediction_type="sample").save_config(partial / "scheduler")

    save_weights(folder, network_files.DESCRIPTION, network.config, network_files.modules_of(network), provenance, save_configs)


def save_refiner(folder: Path, network: refiner_files.RefinerNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder``; see :func:`save_weights`."""
    save_weights(folder, refiner_files.DESCRIPTION, network.config, {refiner_files.WEIGHTS: network}, provenance)
