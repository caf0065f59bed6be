"""The protocol object: configuration in, description out, and a label that changes with whatever decides a number."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from ia_bench.scores.protocol import LpipsSettings, Protocol, ProtocolError, SsimSettings


def test_an_empty_configuration_is_the_papers_protocol() -> None:
    protocol = Protocol.from_config({})
    assert protocol == Protocol()
    assert protocol.label == "paper-v2 (lpips.net=squeeze)"
    assert (protocol.alignment, protocol.mask_threshold) == ("mean_rgb", 0.5)
    assert (protocol.map_points, protocol.render_points, protocol.samples_per_pixel) == (8, 4, 128)


def test_the_configuration_file_says_what_the_defaults_are() -> None:
    shipped = yaml.safe_load((Path(__file__).parents[2] / "conf/protocol/paper-v2.yaml").read_text())
    assert Protocol.from_config(shipped) == Protocol()
    assert sorted(shipped) == sorted({"version", *(field.name for field in fields(Protocol))})


def test_nested_settings_are_read_and_change_the_label() -> None:
    protocol = Protocol.from_config({"name": "mine", "version": 2, "lpips": {"net": "vgg"}, "ssim": {"sigma": 2}})
    assert protocol == Protocol(name="mine", lpips=LpipsSettings(net="vgg"), ssim=SsimSettings(sigma=2.0))
    assert protocol.label == "mine (lpips.net=vgg, ssim.sigma=2.0)"


def test_where_the_weights_lie_is_no_part_of_the_label(tmp_path: Path) -> None:
    weights = tmp_path / "weights.safetensors"
    weights.touch()
    assert Protocol.from_config({"lpips": {"weights": str(weights)}}).label == Protocol().label


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
        ({"samples_per_pixel": 0}, r"protocol\.samples_per_pixel: expected at least 1 .*, found 0"),
        ({"samples_per_pixel": 1.5}, r"protocol\.samples_per_pixel: expected an integer, found 1\.5"),
        ({"mask_threshold": 1.0}, r"protocol\.mask_threshold: expected a coverage in \[0, 1\), found 1\.0"),
        ({"mask_threshold": True}, r"protocol\.mask_threshold: expected a number, found True"),
        ({"ssim": {"sigma": 0}}, r"protocol\.ssim\.sigma: expected a positive number of pixels, found 0\.0"),
        ({"version": 1}, r"protocol\.version: expected 2, .*found 1"),
        ({"map_points": 0}, r"protocol\.map_points: expected at least 1 and at most 65536, found 0"),
        ({"samples_per_pixel": 10**12}, r"protocol\.samples_per_pixel: expected .* at most 65536, found 1000000000000"),
        ({"seed": -1}, r"protocol\.seed: expected at least 0, found -1"),
        ({"name": None}, r"protocol\.name: expected a text, found None"),
    ],
)
def test_bad_settings_are_named_with_what_was_expected(config: dict, message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        Protocol.from_config(config)


def test_the_description_is_json_and_tells_the_window_and_the_version() -> None:
    described = json.loads(json.dumps(Protocol().describe()))
    assert described["ssim"]["window"] == 11
    assert described["version"] == 2
    assert described["label"] == "paper-v2 (lpips.net=squeeze)"
    assert described["reference_renderer"]["bounces"] == 4
    assert described["lpips"]["net"] == "squeeze"
