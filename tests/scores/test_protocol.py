"""The protocol object: configuration in, description out, and a label that changes with whatever decides a number."""

import hashlib
import json

import pytest

from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.scores.protocol import LpipsSettings, Protocol, SsimSettings, shipped


def test_the_papers_protocol_is_the_defaults_and_that_of_published_tables_described_as_ever() -> None:
    assert shipped("paper-v3") == Protocol()
    assert "noise" in Protocol().describe()
    content = json.dumps(shipped("paper-v2").describe(), sort_keys=True).encode()
    assert hashlib.sha256(content).hexdigest()[:12] == "aa9ce6a4d15c"  # of commit 497615e0, part of every protocol_hash


def test_nested_settings_are_read_and_change_the_label() -> None:
    protocol = parsed(Protocol, {"name": "mine", "version": 3, "lpips": {"net": "vgg"}, "ssim": {"sigma": 2}})
    assert protocol == Protocol(name="mine", lpips=LpipsSettings(net="vgg"), ssim=SsimSettings(sigma=2.0))
    assert protocol.label == "mine (lpips.net=vgg, ssim.sigma=2.0)"


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"aligment": "mean_rgb"}, r"unknown setting 'protocol\.aligment'; did you mean 'protocol\.alignment'\?"),
        ({"alignment": "mean_rbg"}, r"value of protocol\.alignment: 'mean_rbg'; did you mean 'mean_rgb'\?"),
        ({"samples_per_pixel": 1.5}, r"protocol\.samples_per_pixel: expected a whole number, found 1\.5"),
        ({"samples_per_pixel": 10**12}, r"protocol\.samples_per_pixel: expected 65536 or less, found 1000000000000"),
        ({"seed": 2**63}, r"protocol\.seed: expected less than 9223372036854775808, found 9223372036854775808"),
    ],
)
def test_bad_settings_are_named_with_what_was_expected(config: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parsed(Protocol, config, "protocol")
