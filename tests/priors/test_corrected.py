"""The corrected prior: the errors of the prior behind it, smaller by exactly the factor asked for."""

import pytest
import torch
from priors.tiny_network import tiny_weights

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.stack import Stack, painted_ball
from ia_bench.priors.contract import COMPONENTS, Distiller, Observations, Samples
from ia_bench.priors.corrected import CorrectedPrior
from ia_bench.priors.diffusion.prior import DiffusionPrior


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tiny_weights(tmp_path_factory.mktemp("weights"), geometry=True))


@pytest.fixture(scope="module")
def stack() -> Stack:
    return painted_ball(16, 24, 3)


WANTED = frozenset({"normals", "visibility", "truth"})


def corrected(weights: str, share: float, **options: object) -> CorrectedPrior:
    return CorrectedPrior(share=share, of_options={"weights": weights, **options})


def truth(stack: Stack, component: str) -> torch.Tensor:
    return stack.truth(component)


@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.125, 0.5, 1.0])
def test_errors_shrink_by_the_share(weights: str, stack: Stack, share: float, guided: bool) -> None:
    guidance = {"albedo": 0.5 * truth(stack, "albedo")} if guided else None
    plain = DiffusionPrior(weights=weights).sample(stack.shown(), seed=3, guidance=guidance)
    samples = corrected(weights, share).sample(stack.shown(WANTED), seed=3, guidance=guidance)
    check_shrunk(plain, samples, stack, share)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_what_is_distilled_is_corrected_too(weights: str, stack: Stack, share: float) -> None:
    renders = {name: 0.5 * truth(stack, name) for name in COMPONENTS}
    plain = DiffusionPrior(weights=weights).distill(stack.shown(), renders, seed=3)
    check_shrunk(plain, corrected(weights, share).distill(stack.shown(WANTED), renders, seed=3), stack, share)
    assert not isinstance(CorrectedPrior(of="regressor"), Distiller)  # only where the prior behind can be


def check_shrunk(plain: Samples, samples: Samples, stack: Stack, share: float) -> None:
    assert set(samples.values) == {"albedo", "specular"}
    assert samples.cost == plain.cost
    assert torch.equal(samples.ceilings["specular"], plain.ceilings["specular"])
    for name, sample in samples.values.items():
        error, left = plain.values[name] - truth(stack, name), sample - truth(stack, name)
        assert float(error.square().mean()) > 1e-4
        assert torch.allclose(left, share * error, atol=1e-6)
        if share in (0, 1):
            assert torch.equal(sample, truth(stack, name) if share == 0 else plain.values[name])


def test_conforms(weights: str, stack: Stack) -> None:
    findings = list(check_prior(lambda: CorrectedPrior(share=0.9, of_options={"weights": weights, "geometry": True}), stack))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 20


def test_the_prior_behind_sees_no_truth(weights: str, stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Observations] = []

    def sample(self: object, observations: Observations, **rest: object) -> Samples:
        shown.append(observations)
        return Samples({name: torch.zeros_like(observations.images) for name in COMPONENTS})

    monkeypatch.setattr(DiffusionPrior, "sample", sample)
    corrected(weights, 0.5).sample(stack.shown(WANTED), seed=0)
    assert [observations.truth for observations in shown] == [None]
