"""The conformance check finds what is wrong: for every rule a prior that breaks it first.

Each broken prior is a small change of ``Sound``, which passes everything. A new rule needs a new entry in ``BROKEN``.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from broken_priors import BROKEN, Offering, Pooling, Remembering, Sound, changed, spoiled

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.painted_ball import painted_ball
from ia_bench.cli.check import main
from ia_bench.priors.contract import Observations, Samples


@pytest.fixture(scope="module")
def ball() -> Observations:
    return painted_ball(20, 20, 3)


def test_sound_prior_passes_everything(ball: Observations) -> None:
    findings = list(check_prior(Sound, ball))
    assert {finding.status for finding in findings} == {"pass"}
    assert len({finding.what for finding in findings}) == len(findings)
    shown = {expected for _, expected in BROKEN.values()}
    never_broken = {f.what for f in findings} - shown
    # Lines without an entry of their own: the same rule as another line, for the other component or another image.
    assert never_broken == {"info", "albedo: premultiplied", "guided albedo", "37 x 31 images"}


def test_what_is_offered_besides_is_checked(ball: Observations) -> None:
    findings = list(check_prior(Offering, ball))
    assert {finding.status for finding in findings} == {"pass"}
    besides = [finding.what for finding in findings if finding.what not in {f.what for f in check_prior(Sound, ball)}]
    assert besides == [
        "specular: ceiling", "coupling", "distilled estimates", "distilled again", "a corrected fit", "corrected again",
        "one corrected on its own", "a sample with geometry", "the same geometry again", "fingerprint",
    ]  # fmt: skip
    assert set(besides) == {expected for _, expected in BROKEN.values()} & set(besides)


def test_a_layer_without_weights_is_no_network(ball: Observations) -> None:
    lines = {finding.what: finding for finding in check_prior(Pooling, ball)}
    assert "cost: network_calls" not in lines
    assert lines["inputs"].status == "pass"


@pytest.mark.parametrize("name", BROKEN)
def test_broken_prior_is_caught(name: str, ball: Observations) -> None:
    make, expected = BROKEN[name]
    first = next(finding for finding in check_prior(make, ball) if finding.status == "fail")
    assert first.what == expected
    assert first.expected
    assert "\n" not in first.found


def test_what_a_prior_raises_is_told_with_its_place_and_goes_no_further(
    ball: Observations, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def explode(*_: object, **__: object) -> None:
        raise SystemError("deep\ninside")

    broken = changed(sample=lambda self, observations, *, seed, guidance=None: explode())
    (found,) = (finding.found for finding in check_prior(broken, ball) if finding.status == "fail")
    assert re.fullmatch(r"SystemError: deep \(test_conformance\.py:\d+; IA_BENCH_DEBUG=1 shows the traceback\)", found)
    assert not capsys.readouterr().err
    monkeypatch.setenv("IA_BENCH_DEBUG", "1")
    list(check_prior(broken, ball))
    assert "in explode" in capsys.readouterr().err


def test_the_method_that_answers_wrongly_is_named(ball: Observations) -> None:
    broken = changed(distill=lambda self, observations, renders, *, seed: Samples({}))
    (found,) = (finding.found for finding in check_prior(broken, ball) if finding.status == "fail")
    assert found == "samples: prior Changed: distill(): values: expected albedo, specular, found nothing"


def test_what_is_set_to_none_is_not_offered(ball: Observations) -> None:
    assert {finding.status for finding in check_prior(changed(distill=None, refine=None), ball)} == {"pass"}


def test_global_state_is_put_back(ball: Observations) -> None:
    deterministic = torch.are_deterministic_algorithms_enabled()
    torch.manual_seed(3)
    np.random.seed(3)
    expected = torch.rand(2), np.random.rand(2)
    torch.manual_seed(3)
    np.random.seed(3)
    list(check_prior(Sound, ball))
    assert torch.equal(torch.rand(2), expected[0])
    assert np.array_equal(np.random.rand(2), expected[1])
    assert torch.are_deterministic_algorithms_enabled() == deterministic


def test_not_guidable_is_never_guided(ball: Observations) -> None:
    def refuse(samples: dict, shown: Observations, guidance: Mapping | None, prior: object) -> None:
        assert guidance is None

    blind = spoiled(refuse, info=replace(Sound.info, guidable=False))
    findings = list(check_prior(blind, ball))
    assert [finding.what for finding in findings if finding.status == "skip"] == ["guidance"]
    assert "fail" not in {finding.status for finding in findings}


def test_painted_ball_is_what_it_says() -> None:
    stack = painted_ball(37, 31, 3)
    images, masks = stack.images, stack.masks
    assert images.shape == (3, 37, 31, 3)
    assert images.dtype == masks.dtype == torch.float32
    assert 0.3 < float((masks > 0.5).float().mean()) < 0.9
    assert set(torch.unique(masks).tolist()) <= {0, 0.25, 0.5, 0.75, 1}
    assert float(stack.truth["albedo"].max()) <= 1
    assert bool((images[masks == 0] == 0).all())
    # closed form: image - specular = albedo x irradiance, so the quotient is grey
    shading = (images - stack.truth["specular"])[masks == 1] / stack.truth["albedo"][masks == 1]
    assert float((shading.amax(-1) - shading.amin(-1)).abs().max()) < 0.3
    assert not torch.equal(images[0], images[1])


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    here = f"{Sound.__module__}:Sound"
    assert main([f"prior={here}", "prior.options.guidance_strength=2"]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[-1].endswith(" passed, 0 failed, 0 skipped")
    assert " samples: albedo, specular: finite float32 tensors on the CPU, without gradient\n" in shown
    assert main([f"prior={Remembering.__module__}:Remembering"]) == 1
    assert "✗ the same geometry again: expected the same sample to the bit" in capsys.readouterr().out
