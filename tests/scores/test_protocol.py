"""The protocol object: configuration in, description out, and a label that changes with whatever decides a number."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ia_bench.scores.protocol import LpipsSettings, Protocol, ProtocolError, SsimSettings


def test_an_empty_configuration_is_the_papers_protocol() -> None:
    protocol = Protocol.from_config({})
    assert protocol == Protocol()
    assert protocol.label == "paper-v1"
    assert (protocol.alignment, protocol.mask_threshold, protocol.samples_per_pixel) == ("mean_rgb", 0.5, 64)


def test_nested_settings_are_read_and_change_the_label() -> None:
    protocol = Protocol.from_config({"name": "mine", "version": 1, "lpips": {"net": "squeeze"}, "ssim": {"sigma": 2}})
    assert protocol == Protocol(name="mine", lpips=LpipsSettings(net="squeeze"), ssim=SsimSettings(sigma=2.0))
    assert protocol.label == "mine (ssim.sigma=2.0, lpips.net=squeeze)"


def test_where_the_weights_lie_is_no_part_of_the_label(tmp_path: Path) -> None:
    weights = tmp_path / "weights.safetensors"
    weights.touch()
    assert Protocol.from_config({"lpips": {"weights": str(weights)}}).label == "paper-v1"


def test_hydra_configuration_is_accepted() -> None:
    omegaconf = pytest.importorskip("omegaconf")
    config = omegaconf.OmegaConf.create({"lpips": {"net": "vgg"}, "mask_threshold": 0.9})
    assert Protocol.from_config(config) == Protocol(mask_threshold=0.9, lpips=LpipsSettings(net="vgg"))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"aligment": "mean_rgb"}, r"protocol\.aligment: no such setting; did you mean alignment\?"),
        ({"lpips": {"nett": "alex"}}, r"protocol\.lpips\.nett: no such setting; did you mean lpips\.net\?"),
        ({"zzz": 1}, r"protocol\.zzz: no such setting; known are name, "),
        (
            {"alignment": "mean_rbg"},
            r"protocol\.alignment: expected one of .*found 'mean_rbg' \(did you mean mean_rgb\?\)",
        ),
        ({"lpips": {"net": "squeez"}}, r"protocol\.lpips\.net: expected one of alex, vgg, squeeze, found 'squeez'"),
        ({"lpips": {"weights": "no/such/file"}}, r"protocol\.lpips\.weights: expected an existing .*'no/such/file'"),
        ({"lpips": "squeeze"}, r"protocol\.lpips: expected a group of settings \(net, weights\), found 'squeeze'"),
        ({"samples_per_pixel": 0}, r"protocol\.samples_per_pixel: expected at least 1, found 0"),
        ({"samples_per_pixel": 1.5}, r"protocol\.samples_per_pixel: expected an integer, found 1\.5"),
        ({"mask_threshold": 1.0}, r"protocol\.mask_threshold: expected a coverage in \[0, 1\), found 1\.0"),
        ({"mask_threshold": True}, r"protocol\.mask_threshold: expected a number, found True"),
        ({"ssim": {"sigma": 0}}, r"protocol\.ssim\.sigma: expected a positive number of pixels, found 0\.0"),
        ({"version": 2}, r"protocol\.version: expected 1, .*found 2"),
        ({"name": None}, r"protocol\.name: expected a text, found None"),
    ],
)
def test_bad_settings_are_named_with_what_was_expected(config: dict, message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        Protocol.from_config(config)


def test_the_description_is_json_and_tells_the_window_and_the_version() -> None:
    described = json.loads(json.dumps(Protocol().describe()))
    assert described["ssim"]["window"] == 11
    assert described["version"] == 1
    assert described["label"] == "paper-v1"
    assert described["lpips"]["net"] == "alex"
