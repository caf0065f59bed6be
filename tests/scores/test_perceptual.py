"""LPIPS against a direct call of the network, and whatever may be missing: weights, package, internet, operators."""

import math
import urllib.error
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from skimage.draw import disk

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.scores import metrics as perceptual
from ia_bench.scores.metrics import Compared, NoScoredPixel, Undefined
from ia_bench.scores.protocol import LpipsSettings, Protocol

WEIGHTS = perceptual.SHIPPED["squeeze"]
SETTINGS = LpipsSettings()

HEIGHT, WIDTH = 37, 43  # larger than the smallest image that LPIPS takes, and not square
RANDOM = np.random.default_rng(0)
TRUE, GUESS = RANDOM.random((HEIGHT, WIDTH, 3)), RANDOM.random((HEIGHT, WIDTH, 3))
DISC, EVERYWHERE = np.zeros((HEIGHT, WIDTH), bool), np.ones((HEIGHT, WIDTH), bool)
DISC[disk((18, 21), 12)] = True


def distance(guess: np.ndarray, mask: np.ndarray = DISC, settings: LpipsSettings = SETTINGS) -> float:
    return perceptual.lpips(Compared.of_object(guess, TRUE, mask, Protocol(lpips=settings)))


@pytest.fixture(autouse=True)
def nothing_remembered() -> None:
    perceptual.load.cache_clear()


@pytest.mark.filterwarnings("ignore::UserWarning")  # torchvision deprecates how lpips calls it
def test_a_masked_value_is_the_networks_own_map_averaged_over_the_mask() -> None:
    import torch

    import_torchvision()
    import lpips
    from safetensors.torch import load_file

    network = lpips.LPIPS(net="squeeze", spatial=True, pnet_rand=True, pretrained=False, verbose=False)
    before = torch.get_rng_state()
    assert not isinstance(perceptual.load(SETTINGS), str)
    assert torch.equal(torch.get_rng_state(), before)  # loading leaves the global random state alone
    network.load_state_dict(load_file(WEIGHTS))
    white = [torch.tensor(np.where(DISC[..., None], image, 1.0)).float() for image in (GUESS, TRUE)]
    with torch.no_grad():
        spatial = network(*(2 * image.permute(2, 0, 1)[None] - 1 for image in white))[0, 0].numpy()
    assert distance(GUESS) == pytest.approx(float(spatial[DISC].mean()), rel=1e-5)


def test_weights_of_another_network_and_files_of_none_are_named_not_used(tmp_path: Path) -> None:
    broken = tmp_path / "broken.safetensors"
    broken.write_text("not weights")
    for net, path in (("alex", WEIGHTS), ("squeeze", broken)):
        message = rf"{path.name} is no full state dict of lpips net {net}"
        with pytest.raises(Undefined, match=message):
            distance(GUESS, settings=LpipsSettings(net=net, weights=str(path)))
        with pytest.raises(InputError, match=r"protocol\.lpips\.weights: .*" + message):  # before a run
            perceptual.check_weights(LpipsSettings(net=net, weights=str(path)))
    with pytest.raises(InputError, match=r"protocol\.lpips\.weights: expected an existing .*'no/such/file'"):
        perceptual.check_weights(LpipsSettings(weights="no/such/file"))
    perceptual.check_weights(LpipsSettings(net="squeeze", weights=str(WEIGHTS)))
    perceptual.check_weights(LpipsSettings(net="alex"))


def test_empty_masks_and_small_images_have_no_number() -> None:
    with pytest.raises(NoScoredPixel):
        distance(GUESS, ~EVERYWHERE)
    with pytest.raises(Undefined, match="image of 43 x 31 pixels is smaller than 32"):
        perceptual.lpips(Compared.of_object(GUESS[:31], TRUE[:31], EVERYWHERE[:31]))


def test_without_internet_there_is_a_reason_and_it_is_remembered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    attempts = []

    def unreachable(*_: object, **__: object) -> None:
        attempts.append(perceptual.socket.getdefaulttimeout())
        raise urllib.error.URLError("Name or service not known")

    monkeypatch.setenv("TORCH_HOME", str(tmp_path))  # nothing cached
    monkeypatch.setattr("torch.hub.urlopen", unreachable)
    for _ in range(2):
        with pytest.raises(Undefined, match="net alex can be neither read nor downloaded: .*not known"):
            distance(GUESS, settings=LpipsSettings(net="alex"))
    assert attempts == [perceptual.DOWNLOAD_SECONDS]
    assert perceptual.socket.getdefaulttimeout() is None


def test_a_damaged_download_and_weights_that_are_no_numbers_cost_this_metric_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cached = tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    cached.parent.mkdir(parents=True)
    cached.write_bytes(b"")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(Undefined, match="net alex can be neither read nor downloaded: Ran out of input"):
        distance(GUESS, settings=LpipsSettings(net="alex"))
    weights = load_file(WEIGHTS)
    name = next(key for key in weights if key.startswith("net."))
    save_file(weights | {name: torch.full_like(weights[name], math.nan)}, tmp_path / "nan.safetensors")
    with pytest.raises(InputError, match="net squeeze hold NaN or infinity"):
        perceptual.check_weights(LpipsSettings(weights=str(tmp_path / "nan.safetensors")))
