"""The head at full resolution: what it makes of an image before and after its gain is known."""

from __future__ import annotations

import pytest
import torch
from priors.tiny_network import tiny_config

from ia_bench.priors.diffusion.network import MaterialNetwork


def ask(network: MaterialNetwork) -> tuple[torch.Tensor, torch.Tensor]:
    """Output of a regressor and the image (2, 3, 16, 16) that it saw."""
    condition = torch.rand(2, 8, 16, 16, generator=torch.Generator().manual_seed(0)) * 2 - 1
    with torch.no_grad():
        return network(None, torch.full((2,), 999), condition), condition[:, :3]


def network(*components: str) -> MaterialNetwork:
    torch.manual_seed(0)
    return MaterialNetwork(tiny_config("regressor", components=components)).eval()


@pytest.mark.parametrize("components", [("albedo", "specular"), ("specular", "albedo"), ("albedo",), ("specular",)])
def test_the_first_guess_of_the_albedo_is_the_image_and_of_specular_shading_nothing(components: tuple[str, ...]) -> None:
    output, image = ask(network(*components))
    expected = [image if name == "albedo" else torch.zeros_like(image) for name in components]
    torch.testing.assert_close(output, torch.cat(expected, 1))


def test_a_constant_gain_divides_the_display_values_of_the_image_texture_and_all() -> None:
    prior = network("albedo", "specular")
    with torch.no_grad():
        prior.head.leave.bias[-3:] = torch.tensor([-0.5, 0.0, 1.0])
        prior.head.leave.bias[3:6] = 0.25
    output, image = ask(prior)
    display = (1 + image) / 2
    torch.testing.assert_close((1 + output[:, :3]) / 2, display * torch.tensor([0.5, 1.0, 2.0])[:, None, None])
    torch.testing.assert_close(output[:, 3:], torch.full_like(image, 0.25))


def test_the_head_learns_from_the_features_of_the_unet() -> None:
    prior = network("albedo", "specular")
    torch.nn.init.normal_(prior.head.leave.weight)
    output, _ = ask(prior)
    torch.nn.init.zeros_(prior.unet.conv_out.weight)
    assert not torch.allclose(ask(prior)[0], output)
