"""``python -m ia_bench.check prior=NAME`` or ``reader=NAME``: does a plugin keep its contract? A tick or a cross per question."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, status_of
from ia_bench.common.suggestions import unknown
from ia_bench.readers.contract import SceneReader
from ia_bench.runs.composition import compose
from ia_bench.runs.config import RunConfig
from ia_bench.runs.scene import open_scene

USAGE = """\
python -m ia_bench.check prior=NAME [prior.options.KEY=VALUE ...]
python -m ia_bench.check reader=NAME scene.path=FOLDER [reader.options.KEY=VALUE ...]

Checks that a prior keeps its contract (shapes, ranges, determinism, seeds, guidance, wrong input), on small posed
images: the shipped scene tiny, or a computed one where it is absent. Checks that a reader keeps its own (shapes, ranges, cameras,
no truth unasked, the same again), and tells what of that scene will be scored. NAME is one of those below, or module:Class.

Priors
{priors}
Readers
{readers}
Exit status: 0 all ticks, 1 at least one cross, 2 a mistake in what was asked.
"""

MARKS = {"pass": ("✓", "green"), "fail": ("✗", "red"), "skip": ("-", "bright_black")}
ASCII_MARKS = {"pass": "ok", "fail": "FAIL", "skip": "skip"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(USAGE.format(priors=_plugins("prior"), readers=_plugins("reader")), end="")
        return OK
    return status_of(lambda: check(*_read(arguments), Console(highlight=False, soft_wrap=True)))


def check(config: RunConfig, kind: registry.Kind, console: Console) -> int:
    """Check the plugin of that kind, print a line per finding, return the exit status. Raises InputError if it cannot be used."""
    from ia_bench.checks.conformance import check_prior  # these bring in torch
    from ia_bench.checks.readers import check_reader
    from ia_bench.checks.stack import example_stack

    def make_prior() -> object:
        return registry.create("prior", config.prior.name, config.prior.target, config.prior.options)

    def make_reader() -> SceneReader:
        return open_scene(config.scene, config.reader)

    if kind == "prior":
        make_prior()  # a mistake in its name or options is the user's, not a broken contract
        stack, what = example_stack()
        findings, title = check_prior(make_prior, stack), f"prior {config.prior.name} ({config.prior.target}) on {what}"
    else:
        make_reader()
        findings = check_reader(make_reader)
        title = f"reader {config.reader.name} ({config.reader.target}) on scene {config.scene.name}"
    console.print(Text(title))
    counts = dict.fromkeys(MARKS, 0)
    for finding in findings:
        counts[finding.status] += 1
        mark, style = MARKS[finding.status]
        if console.options.ascii_only:
            mark = f"{ASCII_MARKS[finding.status]:<4}"
        said = f"expected {finding.expected}, found {finding.found}" if finding.expected else finding.found
        console.print(Text.assemble((mark, style), f" {finding.what}: {said}"))
    console.print(Text(f"{counts['pass']} passed, {counts['fail']} failed, {counts['skip']} skipped"))
    return FAULT if counts["fail"] else OK


def _read(arguments: Sequence[str]) -> tuple[RunConfig, registry.Kind]:
    """What the command line asks for, and the kind of plugin. Raises InputError for anything that is not about it."""
    keys = [text.partition("=")[0] for text in arguments]
    kind: registry.Kind = "reader" if "reader" in keys else "prior"
    about = ["reader", "scene"] if kind == "reader" else ["prior"]
    for key in keys:
        if key.lstrip("+~").split(".")[0] not in about:
            raise InputError(unknown("setting of ia_bench.check", key.lstrip("+~").split(".")[0], about))
    if kind not in keys:
        raise InputError("expected prior=NAME or reader=NAME; --help lists them")
    return compose(arguments), kind


def _plugins(kind: registry.Kind) -> str:
    working, broken = registry.load_installed(kind)
    found = {**registry.built_in(kind), **{name: registry.installed(kind)[name] for name in working}}
    lines = [f"  {name:<20}{plugin.target} of {plugin.distribution}\n" for name, plugin in found.items()]
    return "".join([*lines, *(f"  ! {problem}\n" for problem in broken)])
