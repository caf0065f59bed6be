"""The head at full resolution: what it makes of an image before and after its gain is known."""

import pytest
import torch
from priors.tiny_network import tiny_config, tiny_weights
from safetensors.torch import load_file, save_file
from spoils import edited

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.network import MaterialNetwork, load_network
from ia_bench_training.saving import save_network

UNET, ENCODER = "unet/diffusion_pytorch_model.safetensors", "encoder.safetensors"


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


@pytest.fixture
def folder(tmp_path):
    return tiny_weights(tmp_path / "weights")


def output_of(network, seed=0):
    generator = torch.Generator().manual_seed(seed)
    noisy, condition = (torch.randn(2, channels, 16, 16, generator=generator) for channels in (6, 8))
    return network(noisy, torch.tensor([3, 700]), condition)


def test_a_network_comes_back_as_it_was_up_to_half_precision(tmp_path):
    torch.manual_seed(0)
    network = MaterialNetwork(tiny_config()).eval()
    save_network(tmp_path / "weights", network, {"steps": 7})
    again, provenance = load_network(tmp_path / "weights")
    assert provenance == {"steps": 7}
    assert again.config == network.config
    with torch.no_grad():
        torch.testing.assert_close(output_of(again), output_of(network), atol=0.02, rtol=0.02)


def test_diffusers_reads_the_unet_and_the_schedule(folder):
    import_torchvision()
    from diffusers import DDIMScheduler, UNet2DConditionModel

    unet = UNet2DConditionModel.from_pretrained(folder / "unet")
    network, _ = load_network(folder)
    for name, value in network.unet.state_dict().items():
        assert torch.equal(value, unet.state_dict()[name])
    assert DDIMScheduler.from_pretrained(folder / "scheduler").config.prediction_type == "sample"


def change_weights(folder, change, name=UNET):
    weights = load_file(folder / name)
    change(weights)
    save_file(weights, folder / name)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (edited("prior.json", lambda d: d.pop("network")), "prior.json: expected a table under 'network', found None"),
        (edited("prior.json", lambda d: d["network"].update(chanels=[16])), "did you mean 'network.channels'"),
        (lambda f: (f / ENCODER).write_bytes(b"\x80\x04cos\nsystem\n"), "encoder.safetensors: expected safetensors"),
        (lambda f: change_weights(f, lambda w: w.update({"conv_in.bias": torch.zeros(3)})), r"of shape \(16,\), found \(3,\)"),
        (lambda f: change_weights(f, lambda w: w["conv_in.bias"].fill_(float("nan"))), "conv_in.bias: expected finite values"),
        (lambda f: change_weights(f, lambda w: w.update(more=torch.zeros(1))), "more: a tensor that the config has no place"),
    ],
)
def test_what_cannot_be_used_names_file_and_key(folder, spoil, message):
    spoil(folder)
    with pytest.raises(InputError, match=message):
        load_network(folder)
