"""The small networks that fields of these papers are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn


def positional_encoding(values: Tensor, frequencies: int) -> Tensor:
    """x, and sin and cos of 2^k x for k < ``frequencies`` (Mildenhall et al. 2020, without pi): (N, C) to (N, C (2 F + 1))."""
    scaled = (values[:, None] * 2.0 ** torch.arange(frequencies, device=values.device)[:, None]).flatten(1)
    return torch.cat([values, torch.sin(scaled), torch.cos(scaled)], 1)


def encoded(channels: int, frequencies: int) -> int:
    """How many channels :func:`positional_encoding` makes of ``channels``."""
    return channels * (2 * frequencies + 1)


def perceptron(widths: Sequence[int], activation: Callable[[], nn.Module] = nn.ReLU) -> nn.Sequential:
    """Linear layers between these ``widths``, the activation between each two of them and none at the end."""
    layers: list[nn.Module] = []
    for place, (before, after) in enumerate(zip(widths[:-1], widths[1:], strict=True)):
        layers += ([activation()] if place else []) + [nn.Linear(before, after)]
    return nn.Sequential(*layers)


@torch.no_grad()
def initialise(network: nn.Module, generator: torch.Generator, gain: float = 1.0) -> None:
    """Draw the weights of linear layers again, uniform in +-gain / sqrt(inputs), from a generator of the fit.

    ``gain``: 1 as torch has it; sqrt(6) keeps the variance of what passes through ReLU (He et al. 2015), with which a network
    learns detail in fewer steps.
    """
    for layer in network.modules():
        if isinstance(layer, nn.Linear):
            bound = 1 / math.sqrt(layer.in_features)
            layer.weight.uniform_(-gain * bound, gain * bound, generator=generator)
            if layer.bias is not None:
                layer.bias.uniform_(-bound, bound, generator=generator)
