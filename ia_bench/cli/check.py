"""``ia-bench check``: does a plugin keep its contract? A tick or a cross per question."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ia_bench.common import registry
from ia_bench.common.arguments import value_of
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import FAULT, OK, command, say
from ia_bench.common.machine import settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.runs.composition import compose
from ia_bench.runs.config import expect_outside, method_of, slug

if TYPE_CHECKING:
    from ia_bench.checks.finding import Finding
    from ia_bench.methods.contract import Problem
    from ia_bench.runs.config import RunConfig
    from ia_bench.scenes.scene import Scene

    Checked = tuple[str, Iterable[Finding]]

USAGE = """\
ia-bench check prior=NAME [prior.options.KEY=VALUE ...]
ia-bench check method=NAME [method.options.KEY=VALUE ...]
ia-bench check coupling=NAME [coupling.options.KEY=VALUE ...]
ia-bench check regulariser=NAME [regulariser.options.KEY=VALUE ...]
ia-bench check reader=NAME scene.path=FOLDER [reader.options.KEY=VALUE ...] [sheet=FILE.png]

Checks that a plugin keeps its contract. NAME is one that ia-bench run --choices lists, or module:Class.

A prior is asked about small computed images of a painted ball: shapes, ranges, determinism, seeds, guidance.
A method reconstructs tiny (scene=NAME or scene.path=FOLDER: another one) with preset=smoke: whether it sees no truth,
repeats and resumes to the bit (on the CPU), predicts what it says it does, and is scored. prior=NAME gives it one to ask.
A coupling and a regulariser are asked about tiny, and about samples and materials that are made up: what they give back,
whether it repeats, whether a coupling goes on from a checkpoint. prior=NAME is the prior of the fit.
A reader reads the scene: shapes, ranges, cameras, no truth unasked, the same again; what was found, what is missing and
what will be scored. A sheet of photographs with the outline of the mesh is written to sheet=FILE.png
(runs/contact_sheets/SCENE.png): look at it first.

Exit status: 0 all ticks, 1 at least one cross, 2 a mistake in what was asked.
"""
MARKS = {"pass": "✓", "fail": "✗", "skip": "-"}
BALL = 32, 32, 3  # height, width and number of the images that a prior is asked about
SHORT = {"scene": "tiny", "preset": "smoke", "threads": "1"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(lambda: USAGE, _check, arguments)


def _check(arguments: Sequence[str]) -> int:
    keys = [text.partition("=")[0] for text in arguments]
    kind = next((kind for kind in CHECKS if kind in keys), None)
    if kind is None:
        raise InputError(f"expected {', '.join(f'{kind}=NAME' for kind in list(CHECKS)[:-1])} or prior=NAME; --help lists them")
    check, known = CHECKS[kind]
    for key in (key.lstrip("+~").split(".")[0] for key in keys):
        if key not in known:
            raise InputError(unknown("setting of ia-bench check", key, list(known)))
    what, findings = check(arguments)
    say(what, sys.stdout)
    counts = dict.fromkeys(MARKS, 0)
    for finding in findings:
        counts[finding.status] += 1
        said = f"expected {finding.expected}, found {finding.found}"
        if finding.status != "fail":  # what holds
            said = f"{finding.expected}; {finding.found}".strip("; ")
        say(f"{MARKS[finding.status]} {finding.what}: {said}", sys.stdout)
    say(f"{counts['pass']} passed, {counts['fail']} failed, {counts['skip']} skipped", sys.stdout)
    return FAULT if counts["fail"] else OK


def _maker(kind: registry.Kind, name: str, options: Mapping[str, Any]) -> tuple[str, Callable[[], object]]:
    """What messages call the plugin, and what makes it, once it has: a mistake in its options is no broken contract."""
    plugin = registry.find(kind, name)

    def make() -> object:
        return registry.create(kind, plugin.name, plugin.target, options)

    make()
    return f"{kind} {plugin.name} ({plugin.target})", make


def _check_prior(arguments: Sequence[str]) -> Checked:
    from ia_bench.checks.conformance import check_prior  # brings in torch
    from ia_bench.checks.painted_ball import painted_ball

    config = compose(arguments).prior
    what, make = _maker("prior", config.name, config.options)
    return f"{what} on {BALL[2]} computed views of a painted ball, {BALL[0]} x {BALL[1]}", check_prior(make, painted_ball(*BALL))


def _on_tiny(arguments: Sequence[str]) -> tuple[RunConfig, Scene, Callable[[Scene], Problem]]:
    """The configuration of a short run on the CPU, its scene, and what makes a problem of one as that run does.

    On the CPU the same numbers are promised, which rules ask for.
    """
    given = {text.partition("=")[0] for text in arguments}
    short = [f"{key}={value}" for key, value in SHORT.items() if key not in given]
    config = compose([*arguments, *short, "device=cpu"])
    settle_libraries(config.threads or 1)
    from ia_bench.methods.monitor import CostTracker  # brings in torch, as what follows
    from ia_bench.runs.run import problem_of
    from ia_bench.runs.scene import captured_scene

    scene, info = captured_scene(config, lambda _: None), method_of(config).info
    return config, scene, lambda scene: problem_of(config, scene, info, note=lambda _: None, costs=CostTracker())


def _check_method(arguments: Sequence[str]) -> Checked:
    config, scene, make_problem = _on_tiny(arguments)
    from ia_bench.checks.methods import check_method

    what = f"method {config.method.name} ({config.method.target}) on scene {scene.name}"
    return what, check_method(lambda: method_of(config), make_problem, scene)


def _check_coupling(arguments: Sequence[str]) -> Checked:
    config, scene, make_problem = _on_tiny(arguments)
    from ia_bench.checks.fit_parts import check_part

    what, make = _maker("coupling", config.coupling.name, config.coupling.options)
    return f"{what} on scene {scene.name}", check_part("coupling", make, make_problem(scene))


def _check_regulariser(arguments: Sequence[str]) -> Checked:
    """Its options are written ``regulariser.options.KEY=VALUE``: it is part of no configuration by itself."""
    own = {key: value for key, _, value in (text.partition("=") for text in arguments) if key.startswith("regulariser")}
    if not own.get("regulariser"):
        raise InputError("expected regulariser=NAME, found none")
    _, scene, make_problem = _on_tiny([text for text in arguments if not text.startswith("regulariser")])
    from ia_bench.checks.fit_parts import check_part

    name = own.pop("regulariser")
    options = {key.removeprefix("regulariser.options."): value_of(value) for key, value in own.items()}
    what, make = _maker("regulariser", name, options)
    return f"{what} on scene {scene.name}", check_part("regulariser", make, make_problem(scene))


def _check_reader(arguments: Sequence[str]) -> Checked:
    from ia_bench.checks.readers import check_reader
    from ia_bench.runs.scene import open_scene

    config = compose([text for text in arguments if not text.startswith("sheet=")])
    open_scene(config.scene, config.reader)  # as in _maker
    sheets = [text.partition("=")[2] for text in arguments if text.startswith("sheet=")]
    place = Path((*sheets, f"runs/contact_sheets/{slug(config.scene.name)}.png")[0])
    if not place.name:
        raise InputError("sheet=: expected the name of a picture, found none")
    if place.is_dir():
        raise InputError(f"sheet={place}: expected the name of a picture, found a folder")
    expect_outside("sheet", place, config.scene, config.reader)
    make_writable(place.parent, "sheet")
    what = f"reader {config.reader.name} ({config.reader.target}) on scene {config.scene.name}"
    return what, check_reader(lambda: open_scene(config.scene, config.reader), place)


CHECKS: dict[str, tuple[Callable[[Sequence[str]], Checked], tuple[str, ...]]] = {
    "method": (_check_method, ("method", "prior", "coupling", "fit", "scene", "reader", "render", "preset", "threads")),
    "reader": (_check_reader, ("reader", "scene", "sheet")),
    "coupling": (_check_coupling, ("coupling", "prior", "scene")),
    "regulariser": (_check_regulariser, ("regulariser", "prior", "scene")),
    "prior": (_check_prior, ("prior",)),
}
"""What checks a kind, and the settings that bear on it; the first kind that the command line names is checked."""
