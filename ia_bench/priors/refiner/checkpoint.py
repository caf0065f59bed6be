"""The refiner's weights on disk: one safetensors file, with the network's shape and where it comes from as JSON beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ia_bench.priors.refiner.network import RefinerConfig, RefinerNetwork
from ia_bench.priors.weight_files import fill, read_description, save_weights

DESCRIPTION, WEIGHTS = "refiner.json", "refiner.safetensors"


def save_refiner(folder: Path, network: RefinerNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder``; see :func:`ia_bench.priors.weight_files.save_weights`."""
    save_weights(folder, DESCRIPTION, network.config, {WEIGHTS: network}, provenance)


def load_refiner(folder: Path) -> RefinerNetwork:
    """The network in ``folder``, in float32 and evaluation mode. Raises InputError as :func:`ia_bench.priors.weight_files.fill`."""
    network = RefinerNetwork(read_description(folder / DESCRIPTION, RefinerConfig)[0])
    fill(network, folder / WEIGHTS)
    return network.eval().requires_grad_(False)
