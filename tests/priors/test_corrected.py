"""The corrected prior: the errors of the prior behind it, smaller by exactly the factor asked for."""

from pathlib import Path

import pytest
import torch
from priors.tiny_network import tiny_weights

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.painted_ball import painted_ball
from ia_bench.common.errors import PluginError
from ia_bench.priors.contract import COMPONENTS, Distiller, Observations, PriorInfo, Samples
from ia_bench.priors.corrected import CorrectedPrior
from ia_bench.priors.diffusion.prior import DiffusionPrior


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tiny_weights(tmp_path_factory.mktemp("weights"), geometry=True))


@pytest.fixture(scope="module")
def ball() -> Observations:
    return painted_ball(16, 24, 3)


def corrected(weights: str, share: float, **options: object) -> CorrectedPrior:
    return CorrectedPrior(share=share, of_options={"weights": weights, **options})


@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.125, 0.5, 1.0])
def test_errors_shrink_by_the_share(weights: str, ball: Observations, share: float, guided: bool) -> None:
    guidance = {"albedo": 0.5 * ball.truth["albedo"]} if guided else None
    plain = DiffusionPrior(weights=weights).sample(ball, seed=3, guidance=guidance)
    samples = corrected(weights, share).sample(ball, seed=3, guidance=guidance)
    check_shrunk(plain, samples, ball, share)


def test_a_name_stands_for_the_options_of_its_file() -> None:
    """prior=letter is the diffusion model to the letter, and so it is behind another one, but for what is given."""
    letter = CorrectedPrior(of="letter", of_options={"steps": 7}).prior
    assert (letter.steps, letter.eta, letter.guidance_rule, letter.guidance_norm) == (7, 1.0, "paper", "l2")
    resolved = CorrectedPrior.resolved_options({"of": "letter"})["of_options"]
    assert (resolved["steps"], resolved["eta"]) == (20, 1.0)


def test_files_that_the_options_of_a_plug_in_name_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plugged_prior.py").write_text("class P:\n    def __init__(self, *, weights): ...\n    def sample(self): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "a.pt").write_bytes(b"a")
    files = CorrectedPrior.files({"of": "plugged_prior:P", "of_options": {"weights": str(tmp_path / "a.pt")}})
    assert {path.name for path in files} == {"a.pt", "plugged_prior.py"}


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_what_is_distilled_is_corrected_too(weights: str, ball: Observations, share: float) -> None:
    renders = {name: 0.5 * ball.truth[name] for name in COMPONENTS}
    plain = DiffusionPrior(weights=weights).distill(ball, renders, seed=3)
    check_shrunk(plain, corrected(weights, share).distill(ball, renders, seed=3), ball, share)
    assert not isinstance(CorrectedPrior(of="regressor"), Distiller)  # only where the prior behind can be


def check_shrunk(plain: Samples, samples: Samples, ball: Observations, share: float) -> None:
    assert set(samples.values) == {"albedo", "specular"}
    assert samples.cost == plain.cost
    assert torch.equal(samples.ceilings["specular"], plain.ceilings["specular"])
    for name, sample in samples.values.items():
        error, left = plain.values[name] - ball.truth[name], sample - ball.truth[name]
        assert float(error.square().mean()) > 1e-4
        assert torch.allclose(left, share * error, atol=1e-6)
        if share in (0, 1):
            assert torch.equal(sample, ball.truth[name] if share == 0 else plain.values[name])


class Grey:
    info = PriorInfo(frozenset({"albedo"}))

    def sample(self, observations: Observations, *, seed: int, guidance: object = None) -> Samples:
        return Samples({"albedo": observations.images.mean(-1, keepdim=True)})


class Untold(Grey):
    info = None  # type: ignore[assignment]


def test_the_prior_behind_keeps_the_contract(ball: Observations) -> None:
    with pytest.raises(
        PluginError, match=r"^prior Grey: sample\(\): albedo: expected shape \(3, 16, 24, 3\), found \(3, 16, 24, 1\)"
    ):
        CorrectedPrior(of=f"{__name__}:Grey").sample(ball, seed=0)
    with pytest.raises(PluginError, match=r"^prior Untold: info: expected a .*PriorInfo, found None"):
        CorrectedPrior(of=f"{__name__}:Untold")


def test_conforms(weights: str, ball: Observations) -> None:
    findings = list(check_prior(lambda: CorrectedPrior(share=0.9, of_options={"weights": weights, "geometry": True}), ball))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 20


def test_the_prior_behind_sees_no_truth(weights: str, ball: Observations, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Observations] = []

    def sample(self: object, observations: Observations, **rest: object) -> Samples:
        shown.append(observations)
        return Samples({name: torch.zeros_like(observations.images) for name in COMPONENTS})

    monkeypatch.setattr(DiffusionPrior, "sample", sample)
    corrected(weights, 0.5).sample(ball, seed=0)
    assert [observations.truth for observations in shown] == [None]
