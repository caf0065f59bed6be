"""The refiner: what its network is given, what it leaves alone, and its weights on disk."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from priors.tiny_network import tiny_weights
from torch import Tensor

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.painted_ball import painted_ball
from ia_bench.priors.contract import COMPONENTS, Refiner
from ia_bench.priors.corrected import CorrectedPrior
from ia_bench.priors.refiner import DESCRIPTION, RefinerConfig, RefinerNetwork, RefinerPrior, Seen, load_refiner, see
from ia_bench_training.saving import save_refiner

BALL = painted_ball(37, 31, 3)


def trained(seed: int = 0) -> RefinerNetwork:
    """A network whose last layer, too, says something."""
    torch.manual_seed(seed)
    network = RefinerNetwork(RefinerConfig((8, 16)))
    torch.nn.init.normal_(network.conv_out.weight, std=0.05)
    return network.eval()


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("refiner")
    save_refiner(root / "refiner", trained(), {})
    return {"weights": str(tiny_weights(root / "regressor", "regressor")), "refiner": str(root / "refiner")}


def renders() -> dict[str, Tensor]:
    masks = BALL.masks[..., None]
    parts = {name: 0.7 * BALL.truth[name] + 0.1 * masks for name in COMPONENTS}
    evidence = torch.tensor([0.1, 0.3]) * masks
    return {**parts, "radiance": 0.8 * BALL.images + 0.05 * masks, "roughness": 0.4 * masks, "evidence": evidence}


def seen(images: Tensor, parts: dict[str, Tensor]) -> Seen:
    return see(images, BALL.masks, parts, BALL.normals, BALL.visibility, BALL.view_count)


def test_it_keeps_the_contract(folders: dict[str, str]) -> None:
    findings = check_prior(lambda: RefinerPrior(**folders, precision="float32"), painted_ball(24, 20, 3))
    assert not [finding for finding in findings if finding.status == "fail"]


@pytest.mark.parametrize("factor", [2, 1e-6])
def test_levels_are_no_part_of_what_it_sees(factor: float) -> None:
    """A photograph of another unit with its highlights, or an albedo of half the level, looks the same."""
    image, parts = BALL.images, renders()
    plain = seen(image, parts)
    levels = {"albedo": 0.5, "specular": factor, "radiance": factor}
    other = seen(factor * image, {name: levels.get(name, 1) * values for name, values in parts.items()})
    torch.testing.assert_close(other.features, plain.features, rtol=1e-4, atol=1e-5)
    change = 0.05 * torch.ones(3, 4, *BALL.masks.shape[1:])
    (albedo, roughness), (dark, same) = plain.corrected(change), other.corrected(change)
    torch.testing.assert_close(dark, 0.5 * albedo, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(same, roughness)
    inside = BALL.masks == 1
    torch.testing.assert_close(roughness[inside], torch.full_like(roughness[inside], 0.45))


def test_no_change_gives_back_the_material() -> None:
    parts = renders()
    parts["roughness"] = 0.9 * (BALL.masks > 0)[..., None]  # of a fit that also covers what a photograph's mask leaves out in part
    found = seen(BALL.images, parts).corrected(torch.zeros(3, 4, *BALL.masks.shape[1:]))
    for name, maps, where in zip(("albedo", "roughness"), found, (BALL.masks == 1, BALL.masks > 0), strict=True):
        torch.testing.assert_close(maps[where], parts[name][where].float(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("covered", [1.0, 0.4])
def test_no_change_gives_back_a_small_bright_label_and_glass(covered: float) -> None:
    """An albedo 30 times the mean, which the network sees clipped; and a view that nothing covers by more than a half."""
    shape = BALL.masks[:, :, :, None].shape
    masks = torch.full(shape[:3], covered)
    parts = renders()
    parts["albedo"] = torch.full((*shape[:3], 3), 0.02 * covered)
    parts["albedo"][:, 4:6, 4:6] = 0.8 * covered
    found = see(0 * BALL.images, masks, parts, *(torch.zeros(*shape[:3], channels) for channels in (3, 1, 1)))
    albedo, _ = found.corrected(torch.zeros(3, 4, *shape[1:3]))
    torch.testing.assert_close(albedo, parts["albedo"], rtol=1e-4, atol=1e-6)


def test_views_without_anything_stay_as_they_are(folders: dict[str, str]) -> None:
    prior = RefinerPrior(**folders, precision="float32")
    parts = renders()
    parts["albedo"][1] = 0
    empty = replace(BALL, masks=BALL.masks * torch.tensor([1.0, 1, 0])[:, None, None])
    found = prior.refine(empty, parts)
    assert found.cost == {"network_calls": 1}
    for name, maps in found.values.items():
        assert torch.equal(maps[1:], parts[name][1:])
        assert not torch.equal(maps[0], parts[name][0])


def test_what_lies_around_the_object_does_not_matter(folders: dict[str, str]) -> None:
    """A frame of background around the images, a multiple of the network's stride wide, changes nothing inside."""
    prior = RefinerPrior(**folders, precision="float32")
    parts = renders()
    plain = prior.refine(BALL, parts).values

    def framed(values: Tensor) -> Tensor:
        space = (0, 0) * (values.ndim - 3)
        return torch.nn.functional.pad(values, (*space, 4, 4, 4, 4))

    found = prior.refine(BALL.each(framed), {name: framed(render) for name, render in parts.items()}).values
    for name, maps in plain.items():
        torch.testing.assert_close(found[name][:, 4:-4, 4:-4], maps, rtol=1e-5, atol=1e-6)


def test_weights_come_back(tmp_path: Path) -> None:
    network = trained(1)
    save_refiner(tmp_path / "weights", network, {"steps": 3})
    again = load_refiner(tmp_path / "weights")
    for name, value in network.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=1e-3, atol=1e-6)
    assert json.loads((tmp_path / "weights" / DESCRIPTION).read_text())["provenance"] == {"steps": 3}


def test_samples_are_kept_whatever_corrects_them(folders: dict[str, str], tmp_path: Path) -> None:
    save_refiner(tmp_path / "refiner", trained(1), {})
    regressor = str(tiny_weights(tmp_path / "regressor", "regressor", seed=1))
    others = ({}, {"refiner": str(tmp_path / "refiner")}, {"weights": regressor})
    first, second, third = (RefinerPrior(**{**folders, **other}) for other in others)
    assert first.fingerprint == second.fingerprint != third.fingerprint
    samples = [prior.sample(BALL, seed=0).values["albedo"] for prior in (first, second, third)]
    assert torch.equal(samples[0], samples[1])
    assert not torch.equal(samples[0], samples[2])


def test_it_refines_behind_a_wrapper(folders: dict[str, str]) -> None:
    """What sees truth still corrects a fit as the prior behind it does; what cannot refine offers nothing."""
    corrected = CorrectedPrior(of="refiner", share=0.5, of_options=folders)
    assert isinstance(corrected, Refiner)
    plain = RefinerPrior(**folders).refine(BALL, renders()).values
    found = corrected.refine(BALL, renders()).values
    assert all(torch.equal(found[name], plain[name]) for name in ("albedo", "roughness"))
    assert not isinstance(CorrectedPrior(of="regressor"), Refiner)
