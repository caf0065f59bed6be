"""The refiner's weights on disk: one safetensors file, with the network's shape and where it comes from as JSON beside it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from safetensors.torch import save_file

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.settings import parsed
from ia_bench.priors.refiner.network import RefinerConfig, RefinerNetwork
from ia_bench.priors.weight_files import fill

FORMAT = 1
DESCRIPTION, WEIGHTS = "refiner.json", "refiner.safetensors"


def save_refiner(folder: Path, network: RefinerNetwork, provenance: dict[str, Any]) -> None:
    """Write ``network`` to ``folder`` in half precision. ``provenance``: data, steps, seconds, figures (JSON values)."""
    folder.mkdir(parents=True, exist_ok=True)
    described = {"format": FORMAT, "network": dataclasses.asdict(network.config), "provenance": provenance}
    with whole_file(folder / WEIGHTS) as partial:
        save_file({name: value.half().contiguous() for name, value in network.state_dict().items()}, partial)
    with whole_file(folder / DESCRIPTION) as partial:
        partial.write_text(json.dumps(described, indent=2) + "\n")


def load_refiner(folder: Path) -> RefinerNetwork:
    """The network in ``folder``, in float32 and evaluation mode.

    Raises InputError, naming file and key, for what is missing, damaged or does not fit its description.
    """
    path = folder / DESCRIPTION
    if not is_file(path):
        raise InputError(f"{path}: no such file; expected a folder of weights written by ia_bench_training.train_refiner")
    described = read_json(path)
    if described.get("format") != FORMAT:
        raise InputError(f"{path}: format: expected {FORMAT}, found {described.get('format')}")
    try:
        network = RefinerNetwork(parsed(RefinerConfig, described.get("network") or {}, "network"))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    fill(network, folder / WEIGHTS, network.state_dict())
    return network.eval().requires_grad_(False)
