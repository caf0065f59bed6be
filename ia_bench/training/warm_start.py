"""Starting a network from the weights of another one, also of the other kind or with another meaning of its output."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.checkpoints import load_network
from ia_bench.priors.diffusion.network import FEATURES, MaterialNetwork

FIRST = "unet.conv_in.weight"
ENTER = "head.enter.weight"
LAST = ("unet.conv_out.weight", "unet.conv_out.bias")
SIGN = {("v_prediction", "sample"): -1.0, ("sample", "v_prediction"): -1.0}
"""Where there is only noise, v = -x0: the other output with its sign turned is right there and learned below."""


def warm_start(network: MaterialNetwork, folder: Path) -> None:
    """Take over the weights in ``folder``, which may differ from ``network`` in ``kind`` and ``prediction_type`` only.

    A regressor gets the part of the first layers that reads the image; the part that reads noise starts at zero in a
    diffusion network that starts from a regressor. Raises InputError for every other difference.
    """
    start, _ = load_network(folder)
    config, given = network.config, start.config
    if replace(given, kind=config.kind, prediction_type=config.prediction_type) != config:
        raise InputError(f"init: {folder}: expected a network of {config}, found {given}")
    outputs = (given.prediction_type, config.prediction_type)
    if outputs[0] != outputs[1] and outputs not in SIGN:
        raise InputError(
            f"init: {folder}: network.prediction_type: expected {outputs[0]}, or a change between sample and v_prediction, "
            f"found {outputs[1]}"
        )
    state: dict[str, Tensor] = start.state_dict()
    state[FIRST] = _last_columns(state[FIRST], network.unet.conv_in.weight.shape[1])
    if network.head is not None:
        features, rest = state[ENTER][:, :FEATURES], state[ENTER][:, FEATURES:]
        rest = _last_columns(rest, network.head.enter.weight.shape[1] - FEATURES)
        state[ENTER] = torch.cat([features, rest], 1)
    for name in LAST:
        state[name] = SIGN.get(outputs, 1.0) * state[name]
    network.load_state_dict(state)


def _last_columns(weight: Tensor, count: int) -> Tensor:
    """The last ``count`` input columns of ``weight`` (out, in, k, k), where the condition is; zeros for what is not there."""
    missing = max(count - weight.shape[1], 0)
    zeros = weight.new_zeros(weight.shape[0], missing, *weight.shape[2:])
    return torch.cat([zeros, weight], 1)[:, -count:]
