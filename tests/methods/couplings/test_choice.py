"""Which coupling a run has, and that it says so."""

import pytest

from ia_bench.common.errors import PluginError
from ia_bench.methods.couplings.base import NoCoupling, coupling_of
from ia_bench.methods.couplings.kernel import Kernel
from ia_bench.methods.couplings.targets import Targets
from ia_bench.methods.info import AUTO
from ia_bench.priors.contract import PriorInfo

SAYS = frozenset({"albedo", "specular"})


@pytest.mark.parametrize(
    ("info", "name", "kind", "told"),
    [
        (
            PriorInfo(SAYS, stochastic=False),
            AUTO,
            Kernel,
            ["coupling: kernel, the default; it uses albedo of the prior's albedo, specular"],
        ),
        (
            PriorInfo(SAYS, stochastic=False, coupling="targets"),
            AUTO,
            Targets,
            ["coupling: targets, which the prior recommends; it uses albedo, specular of the prior's albedo, specular"],
        ),
        (PriorInfo(frozenset(), stochastic=False), AUTO, NoCoupling, []),
        (
            PriorInfo(frozenset(), stochastic=False),
            "targets",
            NoCoupling,
            ["coupling: targets has nothing to use, since the prior says nothing"],
        ),
    ],
)
def test_what_is_used_and_why_is_told(info: PriorInfo, name: str, kind: type, told: list[str]) -> None:
    notes: list[str] = []
    assert type(coupling_of(info, name, None, {}, notes.append)) is kind
    assert notes == told


def test_a_recommendation_that_is_not_there_is_refused_with_the_names_that_are() -> None:
    expected = "the prior recommends an unknown coupling 'kernal'; did you mean 'kernel'\\? There are: .*targets"
    with pytest.raises(PluginError, match=expected):
        coupling_of(PriorInfo(SAYS, coupling="kernal"), AUTO, None, {}, print)
