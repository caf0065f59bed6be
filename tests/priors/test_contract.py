"""The priors that come with the project keep the contract, and the protocol classes tell them from other objects."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from priors.tiny_network import tiny_weights

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.stack import painted_ball
from ia_bench.common import registry
from ia_bench.priors.contract import COMPONENTS, Prior, TruthSeer
from ia_bench.priors.none import NoPrior
from ia_bench.priors.oracle import OraclePrior

DIALS = {"scale": 0.02, "shift": 0.02, "noise": 0.02, "blur": 0.7, "baked": 0.2, "inconsistency": 0.05}


def test_every_built_in_prior_is_one(tmp_path: Path) -> None:
    plugins = registry.built_in("prior")
    assert {"none", "oracle", "diffusion", "regressor", "intrinsicanything"} <= set(plugins)
    options = {"regressor": {"weights": str(tiny_weights(tmp_path / "weights", "regressor"))}}
    for plugin in plugins.values():
        if plugin.name == "intrinsicanything":  # needs converted weights; tests/priors/original makes some
            continue
        made = registry.create("prior", plugin.name, plugin.target, options.get(plugin.name, {}))
        assert isinstance(made, Prior)
        assert made.provides <= set(COMPONENTS)
        assert isinstance(made, TruthSeer) == made.sees_truth
    assert not isinstance(object(), Prior)


ALBEDO_ALONE = {"components": ["albedo"], "noise": 0.02}


@pytest.mark.parametrize("options", [{}, DIALS, ALBEDO_ALONE], ids=["exact", "dials", "albedo"])
def test_oracle_conforms(options: dict) -> None:
    findings = list(check_prior(lambda: OraclePrior(**options), painted_ball(16, 24, 3)))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 25
    assert [finding.what for finding in findings if finding.status == "skip"] == ["an image on its own"]


def test_none_provides_nothing_for_any_input() -> None:
    prior = NoPrior()
    assert prior.provides == frozenset()
    assert prior.sample(torch.zeros(0, 1, 1, 3), torch.zeros(0, 1, 1), seed=0) == {}
    assert prior.sample(torch.full((2, 5, 3, 3), torch.nan), torch.ones(2, 5, 3), seed=1, guidance={}) == {}
