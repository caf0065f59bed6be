"""Muon on the hidden weights, against what it promises; AdamW on the others."""

from __future__ import annotations

import torch
from torch import nn

from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench_training.optimiser import MuonAdamW, split_weights


class Layers(nn.Module):
    """A hidden convolution and linear layer, and weights that Muon leaves alone."""

    def __init__(self) -> None:
        super().__init__()
        self.conv_in = nn.Conv2d(16, 16, 3)
        self.hidden = nn.Conv2d(16, 24, 3)
        self.linear = nn.Linear(32, 48)
        self.few = nn.Conv2d(24, 9, 1)


def optimiser(network: nn.Module, rate: float, muon_rate: float) -> MuonAdamW:
    hidden, others = split_weights(network, muon=muon_rate > 0)
    adamw = torch.optim.AdamW(others, lr=rate, weight_decay=0)
    return MuonAdamW(adamw, hidden, muon_rate=muon_rate, weight_decay=0)


def give_gradients(network: nn.Module, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    for weight in network.parameters():
        weight.grad = torch.randn(weight.shape, generator=generator)


def test_every_trained_weight_is_stepped_by_one_of_the_two() -> None:
    network = MaterialNetwork(NetworkConfig(size=16, fold=2, channels=(16, 32), tokens=16))
    hidden, others = split_weights(network, muon=True)
    assert sorted(map(id, hidden + others)) == sorted(id(weight) for weight in network.parameters())
    assert sum(weight.numel() for weight in hidden) > 5 * sum(weight.numel() for weight in others)
    names = {id(weight): name for name, weight in network.named_parameters()}
    assert not any("bias" in names[id(weight)] or "norm" in names[id(weight)] for weight in hidden)
    assert split_weights(network, muon=False)[0] == []


def test_muon_moves_all_directions_of_a_hidden_weight_alike() -> None:
    """Its polynomial leaves singular values near the rate times sqrt(rows / columns), if that is above 1 (Jordan et al. 2024)."""
    torch.manual_seed(0)
    network = Layers()
    before = {name: weight.detach().clone() for name, weight in network.named_parameters()}
    give_gradients(network, 1)
    gradient = network.hidden.weight.grad
    assert gradient is not None
    optimiser(network, rate=1e-3, muon_rate=0.02).step(0.5)
    for name, shape in (("hidden.weight", (24, 144)), ("linear.weight", (48, 32))):
        change = (before[name] - dict(network.named_parameters())[name].detach()).reshape(shape)
        values = torch.linalg.svdvals(change) / (0.5 * 0.02 * max(1, shape[0] / shape[1]) ** 0.5)
        assert float(values.min()) > 0.6
        assert float(values.max()) < 1.25
    turned = before["hidden.weight"] - network.hidden.weight.detach()
    left, _, right = torch.linalg.svd(gradient.reshape(24, 144), full_matrices=False)
    assert float(torch.nn.functional.cosine_similarity(turned.flatten(), (left @ right).flatten(), dim=0)) > 0.98
    for name in ("conv_in.weight", "few.weight", "hidden.bias"):  # the first step of Adam is the rate, whatever the gradient
        change = (before[name] - dict(network.named_parameters())[name].detach()).abs()
        torch.testing.assert_close(change, torch.full_like(change, 0.5e-3), rtol=1e-3, atol=1e-7)


def test_without_muon_it_is_adamw() -> None:
    networks = [Layers(), Layers()]
    networks[1].load_state_dict(networks[0].state_dict())
    mine, plain = optimiser(networks[0], 1e-3, 0), torch.optim.AdamW(networks[1].parameters(), lr=1e-3, weight_decay=0)
    for step in range(3):
        for network in networks:
            give_gradients(network, step)
        mine.step(1.0)
        plain.step()
    for one, other in zip(networks[0].parameters(), networks[1].parameters(), strict=True):
        assert torch.equal(one, other)
