"""The priors that come with the project keep the contract, and the protocol classes tell them from other objects."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.stack import painted_ball
from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.none import NoPrior
from ia_bench.priors.oracle import OraclePrior

DIALS = {"scale": 0.02, "shift": 0.02, "noise": 0.02, "blur": 0.7, "baked": 0.2, "inconsistency": 0.05}


ALBEDO_ALONE = {"components": ["albedo"], "noise": 0.02}


@pytest.mark.parametrize("options", [{}, DIALS, ALBEDO_ALONE], ids=["exact", "dials", "albedo"])
def test_oracle_conforms(options: dict) -> None:
    findings = list(check_prior(lambda: OraclePrior(**options), painted_ball(16, 24, 3)))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 18
    assert [finding.what for finding in findings if finding.status == "skip"] == ["an image on its own"]


def test_none_provides_nothing_for_any_input() -> None:
    prior = NoPrior()
    assert prior.info.provides == frozenset()
    assert prior.sample(Observations(torch.zeros(0, 1, 1, 3), torch.zeros(0, 1, 1)), seed=0) == Samples({})
    unusable = Observations(torch.full((2, 5, 3, 3), torch.nan), torch.ones(2, 5, 3))
    assert prior.sample(unusable, seed=1, guidance={}) == Samples({})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"provides": {"albedo"}}, "provides: expected a frozenset of some of albedo, specular, found {'albedo'}"),
        ({"provides": frozenset({"normals"})}, "provides: expected .*, found frozenset"),
        ({"stochastic": "yes"}, "stochastic: expected True or False, found 'yes'"),
        ({"guidable": None}, "guidable: expected True or False, found None"),
        ({"resolution": 64.0}, "resolution: expected a number of pixels > 0, or None, found 64.0"),
        ({"resolution": 0}, "resolution: expected .*, found 0"),
        ({"resolution": True}, "resolution: expected .*, found True"),
        ({"encoding": {"albedo": "log"}}, "encoding: expected one of linear, srgb for every component provided, found"),
        ({"encoding": {}}, "encoding: expected"),
        ({"encoding": "srgb"}, "encoding: expected .*, found 'srgb'"),
        ({"sees_truth": 1}, "sees_truth: expected True or False, found 1"),
        ({"wants": frozenset({"depth"})}, "wants: expected a frozenset of some of normals, visibility, view_count, truth, found"),
        ({"wants": frozenset({"truth"})}, "wants: expected sees_truth=True of a prior that wants truth, found False"),
    ],
)
def test_an_info_that_cannot_be_meant_is_refused(fields: dict, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        PriorInfo(**{"provides": frozenset({"albedo"}), **fields})


def test_copies_share_no_memory_and_a_selection_keeps_the_order() -> None:
    stack = painted_ball(5, 7, 3)
    shown = replace(stack.shown(frozenset({"normals", "visibility", "truth"})), views=(4, 6, 9))
    copied = shown.copy()
    for name in ("images", "masks", "normals", "visibility"):
        getattr(copied, name).fill_(7)
    assert copied.truth is not None
    assert shown.truth is not None
    copied.truth["albedo"].fill_(7)
    assert torch.equal(shown.images, stack.images)
    assert torch.equal(shown.truth["albedo"], stack.truth("albedo"))
    part = shown.select([2, 0])
    assert part.views == (9, 4)
    assert torch.equal(part.images, stack.images[[2, 0]])
    assert part.truth is not None
    assert part.normals is not None
    assert torch.equal(part.truth["specular"], stack.truth("specular")[[2, 0]])
    assert torch.equal(part.normals, shown.normals[[2, 0]])  # type: ignore[index]
