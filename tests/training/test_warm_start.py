"""What a network is worth before its first step when it starts from another one's weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from priors.tiny_network import tiny_config, tiny_weights

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion.checkpoints import load_network
from ia_bench.priors.diffusion.network import MaterialNetwork, NetworkConfig
from ia_bench.training.warm_start import warm_start


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tiny_weights(tmp_path / "start", seed=5)


def inputs(config: NetworkConfig) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shape = (2, config.output_channels, config.size, config.size)
    condition = torch.randn(2, config.condition_channels, config.size, config.size, generator=generator)
    return torch.randn(shape, generator=generator), torch.full((2,), config.last_timestep), condition


@torch.no_grad()
def test_another_meaning_of_the_output_starts_right_where_there_is_only_noise(folder: Path) -> None:
    """v = -x0 at the last step of a schedule that ends in noise alone."""
    old, _ = load_network(folder)
    assert old.config.prediction_type == "v_prediction"
    new = MaterialNetwork(replace(old.config, prediction_type="sample"))
    warm_start(new, folder)
    noise, timestep, condition = inputs(old.config)
    assert float(new(noise, timestep, condition).abs().mean()) > 1e-3
    torch.testing.assert_close(new(noise, timestep, condition), -old(noise, timestep, condition))


@torch.no_grad()
def test_a_regressor_starts_as_the_diffusion_network_without_noise(folder: Path) -> None:
    old, _ = load_network(folder)
    new = MaterialNetwork(replace(old.config, kind="regressor", prediction_type="sample"))
    warm_start(new, folder)
    noise, timestep, condition = inputs(old.config)
    silent = old(torch.zeros_like(noise), timestep, condition)
    torch.testing.assert_close(new(None, timestep, condition), -silent)


@torch.no_grad()
@pytest.mark.parametrize("head", [0, 8])
def test_a_diffusion_network_that_starts_from_a_regressor_ignores_the_noise(tmp_path: Path, head: int) -> None:
    folder = tiny_weights(tmp_path / "regressor", seed=5, kind="regressor", head=head)
    old, _ = load_network(folder)
    new = MaterialNetwork(replace(old.config, kind="diffusion"))
    warm_start(new, folder)
    noise, timestep, condition = inputs(old.config)
    torch.testing.assert_close(new(noise, timestep, condition), old(None, timestep, condition))


@torch.no_grad()
def test_a_regressor_with_a_head_starts_as_the_diffusion_network_without_noise(tmp_path: Path) -> None:
    folder = tiny_weights(tmp_path / "start", seed=5, prediction_type="sample", head=8)
    old, _ = load_network(folder)
    new = MaterialNetwork(replace(old.config, kind="regressor"))
    warm_start(new, folder)
    noise, timestep, condition = inputs(old.config)
    silent = old(torch.zeros_like(noise), timestep, condition)
    assert float((silent[:, :3] - condition[:, :3]).abs().mean()) > 1e-3
    torch.testing.assert_close(new(None, timestep, condition), silent)


@pytest.mark.parametrize("change", [{"tokens": 32}, {"prediction_type": "epsilon"}])
def test_other_differences_are_refused(folder: Path, change: dict[str, object]) -> None:
    network = MaterialNetwork(replace(tiny_config(), **change))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=f"init: {folder}.*{next(iter(change))}"):
        warm_start(network, folder)
