"""``ia-bench check``: does a plugin keep its contract? A tick or a cross per question."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import yaml
from rich.console import Console
from rich.text import Text

from ia_bench.common import registry
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import FAULT, OK, command
from ia_bench.common.machine import limit_threads
from ia_bench.runs.composition import compose
from ia_bench.runs.config import method_of, slug
from ia_bench.runs.scene import captured_scene, open_scene

if TYPE_CHECKING:
    from ia_bench.checks.finding import Finding
    from ia_bench.methods.contract import Problem
    from ia_bench.readers.contract import SceneReader
    from ia_bench.runs.config import RunConfig
    from ia_bench.scenes.scene import Scene

USAGE = """\
ia-bench check prior=NAME [prior.options.KEY=VALUE ...] [--json]
ia-bench check method=NAME [method.options.KEY=VALUE ...] [--json]
ia-bench check coupling=NAME [coupling.options.KEY=VALUE ...] [--json]
ia-bench check regulariser=NAME [regulariser.options.KEY=VALUE ...] [--json]
ia-bench check reader=NAME scene.path=FOLDER [reader.options.KEY=VALUE ...] [sheet=FILE.png] [--json]

Checks that a plugin keeps its contract. NAME is one of those below, or module:Class.

A prior is asked about small computed images of a painted ball: shapes, ranges, determinism, seeds, guidance, wrong input.
A method reconstructs tiny (scene=NAME or scene.path=FOLDER: another one) with preset=smoke: whether it sees no truth,
repeats and resumes to the bit (on the CPU), predicts what it says it does, and is scored. prior=NAME gives it one to ask.
A coupling and a regulariser are asked about tiny, and about samples and materials that are made up: what they give back,
whether it repeats, whether a coupling goes on from a checkpoint. prior=NAME is the prior of the fit.
A reader reads the scene: shapes, ranges, cameras, no truth unasked, the same again; what was found, what is missing and
what will be scored. A sheet of photographs with the outline of the mesh is written to sheet=FILE.png
(runs/contact_sheets/SCENE.png): look at it first.

{plugins}

Exit status: 0 all ticks, 1 at least one cross, 2 a mistake in what was asked.
"""

MARKS = {"pass": ("✓", "green"), "fail": ("✗", "red"), "skip": ("-", "bright_black")}
ASCII_MARKS = {"pass": "ok", "fail": "FAIL", "skip": "skip"}
SETTINGS = {
    "method": ("method", "prior", "coupling", "fit", "scene", "reader", "render", "preset", "threads"),
    "reader": ("reader", "scene", "sheet"),
    "coupling": ("coupling", "prior", "scene"),
    "regulariser": ("regulariser", "prior", "scene"),
    "prior": ("prior",),
}
"""What may be set of a check, by what is checked; the first of these that is named on the command line."""
BALL = 32, 32, 3  # height, width and number of the images that a prior is asked about
SHORT = {"scene": "tiny", "preset": "smoke", "threads": "1"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(lambda: USAGE.format(plugins="\n".join(map(_plugins, registry.KINDS))), _check, arguments)


def _check(given: Sequence[str]) -> int:
    arguments = [text for text in given if text != "--json"]
    what, findings = CHECKS[_kind(arguments)](arguments)
    if "--json" not in given:
        return _told(what, findings, Console(highlight=False, soft_wrap=True))
    rows = [asdict(finding) for finding in findings]
    print(json.dumps(rows, indent=1))
    return FAULT if any(row["status"] == "fail" for row in rows) else OK


def _told(what: str, findings: Iterable[Finding], console: Console) -> int:
    """Print a line per finding as it is found, and return the exit status."""
    console.print(Text(what))
    counts = dict.fromkeys(MARKS, 0)
    for finding in findings:
        counts[finding.status] += 1
        mark, style = MARKS[finding.status]
        if console.options.ascii_only:
            mark = f"{ASCII_MARKS[finding.status]:<4}"
        said = f"expected {finding.expected}, found {finding.found}"
        if finding.status != "fail":  # what holds
            said = f"{finding.expected}; {finding.found}".strip("; ")
        console.print(Text.assemble((mark, style), f" {finding.what}: {said}"))
    console.print(Text(f"{counts['pass']} passed, {counts['fail']} failed, {counts['skip']} skipped"))
    return FAULT if counts["fail"] else OK


def _kind(arguments: Sequence[str]) -> str:
    """What is to be checked. Raises InputError for nothing, and for a setting that does not bear on it."""
    keys = [text.partition("=")[0] for text in arguments]
    kind = next((kind for kind in SETTINGS if kind in keys), None)
    known = SETTINGS[kind] if kind else tuple(SETTINGS)
    for key in keys:
        if key.lstrip("+~").split(".")[0] not in known:
            raise InputError(unknown("setting of ia-bench check", key.lstrip("+~").split(".")[0], list(known)))
    if kind is None:
        raise InputError(f"expected {', '.join(f'{kind}=NAME' for kind in list(SETTINGS)[:-1])} or prior=NAME; --help lists them")
    return kind


def _maker(kind: registry.Kind, name: str, target: str, options: Mapping[str, Any]) -> Callable[[], object]:
    """What makes the plugin, once it has: a mistake in its name or options is the user's, not a broken contract."""

    def make() -> object:
        return registry.create(kind, name, target, options)

    make()
    return make


def _check_prior(arguments: Sequence[str]) -> tuple[str, Iterable[Finding]]:
    from ia_bench.checks.conformance import check_prior  # brings in torch
    from ia_bench.checks.stack import painted_ball

    config = compose(arguments).prior
    make = _maker("prior", config.name, config.target, config.options)
    what = f"prior {config.name} ({config.target}) on {BALL[2]} computed views of a painted ball, {BALL[0]} x {BALL[1]}"
    return what, check_prior(make, painted_ball(*BALL))


def _on_tiny(arguments: Sequence[str]) -> tuple[RunConfig, Scene, Callable[[Scene], Problem]]:
    """The configuration of a short run on the CPU, its scene, and what makes a problem of one as that run does.

    On the CPU the same numbers are promised, which rules ask for.
    """
    given = {text.partition("=")[0] for text in arguments}
    short = [f"{key}={value}" for key, value in SHORT.items() if key not in given]
    config = compose([*arguments, *short, "device=cpu"])
    limit_threads(config.threads or 1)
    from ia_bench.methods.monitor import CostTracker  # brings in torch, as what follows
    from ia_bench.runs.run import problem_of

    scene, info = captured_scene(config, lambda _: None), method_of(config).info

    def make_problem(scene: Scene) -> Problem:
        return problem_of(config, scene, info, note=lambda _: None, costs=CostTracker())

    return config, scene, make_problem


def _check_method(arguments: Sequence[str]) -> tuple[str, Iterable[Finding]]:
    config, scene, make_problem = _on_tiny(arguments)
    from ia_bench.checks.methods import check_method

    what = f"method {config.method.name} ({config.method.target}) on scene {scene.name}"
    return what, check_method(lambda: method_of(config), make_problem, scene)


def _check_coupling(arguments: Sequence[str]) -> tuple[str, Iterable[Finding]]:
    config, scene, make_problem = _on_tiny(arguments)
    from ia_bench.checks.fit_parts import check_coupling

    plugin = registry.find("coupling", config.coupling.name)
    make = _maker("coupling", plugin.name, plugin.target, config.coupling.options)
    return f"coupling {plugin.name} ({plugin.target}) on scene {scene.name}", check_coupling(make, make_problem(scene))


def _check_regulariser(arguments: Sequence[str]) -> tuple[str, Iterable[Finding]]:
    """Its options are written ``regulariser.options.KEY=VALUE``: it is part of no configuration by itself."""
    own = dict(text.split("=", 1) for text in arguments if text.startswith("regulariser") and "=" in text)
    _, scene, make_problem = _on_tiny([text for text in arguments if not text.startswith("regulariser")])
    from ia_bench.checks.fit_parts import check_regulariser

    plugin = registry.find("regulariser", own.pop("regulariser"))
    options = {key.removeprefix("regulariser.options."): yaml.safe_load(value) for key, value in own.items()}
    make = _maker("regulariser", plugin.name, plugin.target, options)
    return f"regulariser {plugin.name} ({plugin.target}) on scene {scene.name}", check_regulariser(make, make_problem(scene))


def _check_reader(arguments: Sequence[str]) -> tuple[str, Iterable[Finding]]:
    from ia_bench.checks.readers import check_reader

    sheet = next((text.partition("=")[2] for text in arguments if text.startswith("sheet=")), None)
    config = compose([text for text in arguments if not text.startswith("sheet=")])

    def make() -> SceneReader:
        return open_scene(config.scene, config.reader)

    make()
    place = Path(sheet) if sheet else Path("runs", "contact_sheets", f"{slug(config.scene.name)}.png")
    return f"reader {config.reader.name} ({config.reader.target}) on scene {config.scene.name}", check_reader(make, place)


CHECKS: dict[str, Callable[[Sequence[str]], tuple[str, Iterable[Finding]]]] = {
    "prior": _check_prior,
    "method": _check_method,
    "reader": _check_reader,
    "coupling": _check_coupling,
    "regulariser": _check_regulariser,
}


def _plugins(kind: registry.Kind) -> str:
    """The names of a kind, ours and then those of each distribution; and what is broken, a line each."""
    working, broken = registry.load_installed(kind)
    names = {"": list(registry.built_in(kind))}
    for name, plugin in working.items():
        names.setdefault(f" ({plugin.distribution})", []).append(name)
    listed = "; ".join(f"{', '.join(mine)}{whose}" for whose, mine in names.items())
    shown = fill(listed, 118, initial_indent=f"{kind + '=':<14}", subsequent_indent=" " * 14)
    return "\n".join([shown, *(f"  ! {problem}" for problem in broken)])
