"""Untrained networks small enough for tests: their samples mean nothing, but obey every rule."""

from pathlib import Path

import torch

from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench_training.saving import save_network


def tiny_config(kind="diffusion", **changes):
    return NetworkConfig(**{"kind": kind, "size": 16, "channels": (16, 32), "tokens": 16, "head": 8, **changes})


def tiny_weights(folder: Path, kind="diffusion", seed=0, **changes) -> Path:
    """A folder of random weights, as ia_bench_training.train writes them."""
    torch.manual_seed(seed)
    network = MaterialNetwork(tiny_config(kind, **changes))
    torch.nn.init.normal_(network.head.leave.weight, std=0.1)  # which starts at zero
    save_network(folder, network, {"steps": 0})
    return folder
