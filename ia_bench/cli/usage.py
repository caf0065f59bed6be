"""What ``ia-bench run --help`` and ``--choices`` print: what a run does, examples, and what can be chosen."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.paths import conf_folder, scenes_folders

GROUPS = {
    "scene": "what is reconstructed (or scene.path=FOLDER, a scene of your own)",
    "reader": "the format of the scene's files (or module:Class)",
    "capture": "what of it is left out",
    "prior": "what is known of albedo and specular shading beforehand (or module:Class)",
    "coupling": "how a method uses what the prior says (or module:Class)",
    "method": "who reconstructs (or module:Class)",
    "regulariser": "what corrects the material while it is fitted, as fit.regularise=[NAME, ...]",
    "preset": "how much work",
    "protocol": "how results are scored",
}

TEXT = """\
ia-bench run [GROUP=NAME ...] [SETTING=VALUE ...]          (the same: python -m ia_bench ...)

Reconstructs albedo, roughness and light of one object from posed images under one unknown light, with the help of a
prior, scores the result by a declared protocol, and leaves everything in one folder.

  ia-bench run scene=tiny preset=smoke                does it run? (seconds)
  ia-bench run scene=hat prior=combined               one run (a minute)
  ia-bench run scene.path=FOLDER reader=nerfstudio    a scene of your own
  ia-bench run --choices                              what every name below is
  ia-bench run scene=hat --cfg job                    every setting and its value, without running
  ia-bench table table=FILE.yaml                      several runs side by side, then the report

Groups and their names
{choices}
Settings
  out=FOLDER              the run's folder (default: runs/SCENE/ROW-HASH below the current one)
  seed=0 threads=N device=auto|cpu|cuda
  fit.regularise=[NAME, ...]
  fit.*  render.*  capture.*  protocol.*  prior.options.*  reader.options.*

A run that has finished is not repeated; one that was killed goes on from its last checkpoint.
Exit status: 0 done, 1 it could not be done, 2 a mistake in what was asked, 130 or 143 interrupted, with the state saved.
IA_BENCH_DEBUG=1 shows every traceback.
"""


def usage() -> str:
    """The help text, with names of built-in and installed choices. Nothing is imported; ``ia-bench check`` tells broken ones."""
    return TEXT.format(choices="".join(f"{_names(group)}\n" for group in GROUPS))


def choices() -> str:
    """Every group, and every name in it with its line of description."""
    return "\n".join(_described(group, line) for group, line in GROUPS.items())


def _names(group: str) -> str:
    label = group if group == "regulariser" else f"{group}="  # which is no setting of its own
    return fill(" ".join(_choices(group)), 116, initial_indent=f"  {label:<14}", subsequent_indent=" " * 16)


def _choices(group: str) -> dict[str, str]:
    """Name -> what it is."""
    found = {path.stem: _description(path) for path in sorted((conf_folder() / group).glob("*.yaml"))}
    kind = next((kind for kind in registry.KINDS if kind == group), None)
    if kind is not None:
        found |= {name: f"from {plugin.distribution}" for name, plugin in registry.installed(kind).items()}
    return found


def _described(group: str, line: str) -> str:
    found = _choices(group)
    if group == "scene":
        found |= {name: f"(not here) {text}" for name, text in found.items() if name not in _scenes_here()}
    lines = [
        fill(f"{name:<17} {description}", 118, initial_indent=" " * 2, subsequent_indent=" " * 20) + "\n"
        for name, description in found.items()
    ]
    return f"{group + '=':<20}{line}\n" + "".join(lines)


def _scenes_here() -> set[str]:
    try:
        return {folder.name for root in scenes_folders() for folder in root.iterdir()}
    except (InputError, OSError):
        return set()


def _description(path: Path) -> str:
    """The first comment of a YAML file that is no command."""
    comments = (line.removeprefix("# ") for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("# "))
    return next((line for line in comments if not line.startswith(("ia-bench ", "python -m "))), "")
