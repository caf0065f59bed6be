"""Steps depend on their number alone, a state that cannot be used is refused, and validations end where the state does."""

import json
from pathlib import Path

import pytest
import torch
from torch import nn

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench_training.optimiser import MuonAdamW, split_weights
from ia_bench_training.resuming import (
    STATE,
    VALIDATIONS,
    batch_index,
    forget_validations_after,
    load_state,
    save_state,
    write_validation,
)


def test_every_image_is_seen_once_in_every_pass() -> None:
    images, batch = 10, 4
    seen = torch.cat([batch_index(images, batch, 3, step) for step in range(5)])
    for epoch in range(2):
        assert sorted(seen[epoch * images : (epoch + 1) * images].tolist()) == list(range(images))
    assert not torch.equal(seen[:images], seen[images:])
    assert torch.equal(batch_index(images, batch, 3, 4), seen[16:])


def test_validations_beyond_the_last_checkpoint_are_forgotten(tmp_path: Path) -> None:
    forget_validations_after(500, tmp_path)  # of a run that has none yet
    for step in (250, 500, 750):
        write_validation(tmp_path, step, 1.0, {"figure": 0.5})
    path = tmp_path / VALIDATIONS
    path.write_text(path.read_text() + '{"step": 10')
    forget_validations_after(500, tmp_path)
    expected = [{"step": step, "seconds": 1.0, "figure": 0.5} for step in (250, 500)]
    assert [json.loads(line) for line in path.read_text().splitlines()] == expected


def test_a_state_comes_back_to_the_run_that_left_it(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert load_state(folder, "mine") is None
    save_state(folder, "mine", {"weight": torch.arange(3.0)})
    state = load_state(folder, "mine")
    assert state["weight"].tolist() == [0, 1, 2]
    with pytest.raises(InputError, match=r"state\.pt: belongs to a run with other settings"):
        load_state(folder, "another's")
    (folder / STATE).write_bytes((folder / STATE).read_bytes()[:100])
    with pytest.raises(InputError, match=r"state\.pt: expected the state of a training run, found a file that cannot be read"):
        load_state(folder, "mine")
    torch.save([1, 2, 3], folder / STATE)
    with pytest.raises(InputError, match=r"state\.pt: expected format 5, found None; choose another out=FOLDER"):
        load_state(folder, "mine")


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
