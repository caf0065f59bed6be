"""``python -m ia_bench.check prior=NAME``: does a prior keep its contract? A tick or a cross per question."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.text import Text

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain
from ia_bench.common.suggestions import unknown
from ia_bench.runs.composition import compose
from ia_bench.runs.config import PriorConfig

USAGE = """\
python -m ia_bench.check prior=NAME [prior.options.KEY=VALUE ...]

Checks that a prior keeps its contract (shapes, ranges, determinism, seeds, guidance, wrong input), on small posed
images: the shipped scene tiny, or a computed one where it is absent. NAME is one of those below, or module:Class.

Priors
{priors}
Exit status: 0 all ticks, 1 at least one cross, 2 a mistake in what was asked.
"""

MARKS = {"pass": ("✓", "green"), "fail": ("✗", "red"), "skip": ("-", "bright_black")}
ASCII_MARKS = {"pass": "ok", "fail": "FAIL", "skip": "skip"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(USAGE.format(priors=_priors()), end="")
        return OK
    try:
        return check(_read(arguments), Console(highlight=False, soft_wrap=True))
    except InputError as error:
        return complain(str(error))


def check(config: PriorConfig, console: Console) -> int:
    """Check one prior, print a line per finding, and return the exit status. Raises InputError if it cannot be used."""
    from ia_bench.checks.conformance import check_prior  # brings in torch
    from ia_bench.checks.stack import example_stack

    def make() -> object:
        return registry.create("prior", config.name, config.target, config.options)

    make()  # a mistake in its name or options is the user's, not a broken contract
    stack, what = example_stack()
    console.print(Text(f"prior {config.name} ({config.target}) on {what}"))
    counts = dict.fromkeys(MARKS, 0)
    for finding in check_prior(make, stack):
        counts[finding.status] += 1
        mark, style = MARKS[finding.status]
        if console.options.ascii_only:
            mark = f"{ASCII_MARKS[finding.status]:<4}"
        said = f"expected {finding.expected}, found {finding.found}" if finding.expected else finding.found
        console.print(Text.assemble((mark, style), f" {finding.what}: {said}"))
    console.print(Text(f"{counts['pass']} passed, {counts['fail']} failed, {counts['skip']} skipped"))
    return FAULT if counts["fail"] else OK


def _read(arguments: Sequence[str]) -> PriorConfig:
    """The prior that the command line asks for. Raises InputError for anything that is not about a prior."""
    for text in arguments:
        key = text.partition("=")[0].lstrip("+~").split(".")[0]
        if key != "prior":
            raise InputError(unknown("setting of ia_bench.check", key, ["prior"]))
    if not any(text.startswith("prior=") for text in arguments):
        raise InputError("expected prior=NAME; --help lists the priors")
    try:
        return compose(arguments).prior
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(str(error)) from error


def _priors() -> str:
    working, broken = registry.load_installed("prior")
    found = {**registry.built_in("prior"), **{name: registry.installed("prior")[name] for name in working}}
    lines = [f"  {name:<20}{plugin.target} of {plugin.distribution}\n" for name, plugin in found.items()]
    return "".join([*lines, *(f"  ! {problem}\n" for problem in broken)])
