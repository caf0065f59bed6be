"""What ``ia-bench run --help`` and ``--choices`` print: what a run does, examples, and what can be chosen."""

from __future__ import annotations

from contextlib import suppress
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
    """The help text, with names of built-in and installed choices. Nothing is imported."""
    lines = []
    for group in GROUPS:
        label = f"  {_label(group):<14}"
        lines.append(fill(" ".join(_choices(group)), 116, initial_indent=label, subsequent_indent=" " * 16) + "\n")
    return TEXT.format(choices="".join(lines))


def choices() -> str:
    """Every group, and every name in it with its line of description."""
    lines = []
    for group, line in GROUPS.items():
        lines.append(f"{_label(group):<20}{line}")
        for name, about in _choices(group).items():
            lines.append(fill(f"{name:<17} {about}", 118, initial_indent=" " * 2, subsequent_indent=" " * 20))
        lines.append("")
    return "\n".join(lines)


def _label(group: str) -> str:
    return group if group == "regulariser" else f"{group}="  # which is no setting of its own


def _choices(group: str) -> dict[str, str]:
    """Name -> what it is: the first sentence of its YAML file's comments, behind its command, or whose plug-in it is."""
    found, roots = {}, list[Path]()
    with suppress(InputError):  # where no scene is at all
        roots = scenes_folders()
    for path in sorted((conf_folder() / group).glob("*.yaml")):
        comments = [line.removeprefix("# ") for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("# ")]
        said = [line for line in comments if not line.startswith(("@package", "ia-bench "))]
        end = next((place for place, line in enumerate(said) if line.endswith((".", "?"))), len(said))
        about = " ".join(said[: end + 1])
        here = group != "scene" or any((root / path.stem).is_dir() for root in roots)
        found[path.stem] = about if here else f"(not here) {about}"
    for kind in registry.KINDS:
        if kind == group:
            found |= {name: f"from {plugin.distribution}" for name, plugin in registry.installed(kind).items()}
    return found
