"""The corrected prior: the errors of the prior behind it, smaller by exactly the factor asked for."""

from __future__ import annotations

import math

import pytest
import torch
from priors.tiny_network import tiny_weights

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.stack import Stack, painted_ball
from ia_bench.common.errors import InputError
from ia_bench.priors.corrected import CorrectedPrior
from ia_bench.priors.diffusion.prior import DiffusionPrior
from ia_bench.runs.composition import compose


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tiny_weights(tmp_path_factory.mktemp("weights"), geometry=True))


@pytest.fixture(scope="module")
def stack() -> Stack:
    return painted_ball(16, 24, 3)


def corrected(weights: str, stack: Stack, share: float, **options: object) -> CorrectedPrior:
    prior = CorrectedPrior(share=share, of_options={"weights": weights, **options})
    prior.reveal(stack.views)
    return prior


def truth(stack: Stack, component: str) -> torch.Tensor:
    return torch.stack([torch.from_numpy(getattr(view, component)) for view in stack.views])


@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.125, 0.5, 1.0])
def test_errors_shrink_by_the_share(weights: str, stack: Stack, share: float, guided: bool) -> None:
    guidance = {"albedo": 0.5 * truth(stack, "albedo")} if guided else None
    plain = DiffusionPrior(weights=weights).sample(stack.images, stack.masks, seed=3, guidance=guidance)
    samples = corrected(weights, stack, share).sample(stack.images, stack.masks, seed=3, guidance=guidance)
    assert set(samples) == {"albedo", "specular"}
    for name, sample in samples.items():
        error, left = plain[name] - truth(stack, name), sample - truth(stack, name)
        assert float(error.square().mean()) > 1e-4
        assert torch.allclose(left, share * error, atol=1e-6)
        if share in (0, 1):
            assert torch.equal(sample, truth(stack, name) if share == 0 else plain[name])


def test_conforms(weights: str, stack: Stack) -> None:
    findings = list(check_prior(lambda: CorrectedPrior(of_options={"weights": weights, "geometry": True}), stack))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 25


def test_geometry_reaches_the_prior_behind(weights: str, stack: Stack) -> None:
    seeing, blind = (corrected(weights, stack, 1.0, geometry=geometry) for geometry in (True, False))
    assert (seeing.reads_geometry, blind.reads_geometry) == (True, False)
    for prior in (seeing, blind):
        prior.give_geometry(*stack.geometry())
    first, second = (prior.sample(stack.images, stack.masks, seed=0)["albedo"] for prior in (seeing, blind))
    assert not torch.equal(first, second)


def test_calls_are_those_of_the_prior_behind(weights: str, stack: Stack) -> None:
    prior, plain = corrected(weights, stack, 0.5), DiffusionPrior(weights=weights)
    for one in (prior, plain):
        one.sample(stack.images, stack.masks, seed=0)
    assert prior.network_calls == plain.network_calls > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"share": 1.5}, r"prior.options.share: expected a number from 0 to 1, found 1.5"),
        ({"share": math.nan}, r"prior.options.share: expected a number from 0 to 1, found nan"),
        ({"of": "oracle"}, r"prior.options.of: .* found oracle: it sees the truth itself"),
        ({"of": "none"}, r"prior.options.of: .* found none: it provides nothing"),
        ({"of": "difusion"}, r"unknown prior 'difusion'.*diffusion"),
        ({"of_options": {"stps": 2}}, r"stps.*steps"),
    ],
)
def test_wrong_options(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        CorrectedPrior(**options)


def test_options_of_the_command_line_arrive(weights: str) -> None:
    config = compose(["device=cpu", "prior=corrected", f"prior.options.of_options={{weights: {weights}, steps: 2}}"])
    prior = CorrectedPrior(**config.prior.options)
    assert prior.provides == {"albedo", "specular"}


def test_patches_are_those_of_the_prior_behind(weights: str) -> None:
    assert CorrectedPrior(of_options={"weights": weights}).patches == "auto"
    assert CorrectedPrior(of="regressor").patches is None


def test_unrevealed(weights: str, stack: Stack) -> None:
    prior = CorrectedPrior(of_options={"weights": weights})
    with pytest.raises(InputError, match="prior=corrected: asked for images of shape .* was revealed nothing"):
        prior.sample(stack.images, stack.masks, seed=0)
