"""The text of ``python -m ia_bench --help``: what it does, examples, and every choice with its line of description."""

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
python -m ia_bench [GROUP=NAME ...] [SETTING=VALUE ...]

Reconstructs albedo, roughness and light of one object from posed images under one unknown light, with the help of a
prior, scores the result by a declared protocol, and leaves everything in one folder.

Examples
  python -m ia_bench prior=oracle scene=hat          one run
  python -m ia_bench scene=tiny preset=smoke         does it run? (seconds)
  python -m ia_bench scene.path=FOLDER out=RESULTS   a scene of your own, results where you want them
  python -m ia_bench prior=oracle --cfg job          every setting and its value, without running
  python -m ia_bench.table table=FILE.yaml           several runs: every row x scene x seed of a table, side by side
                                                     or on a cluster, then the report (there is no -m)

Choices
{choices}
Settings
  seed=0                  every random draw depends on it
  out=FOLDER              the run's folder; otherwise runs/<scene>/<row>-<hash> below the current folder
  device=auto             auto, cpu or cuda
  threads=N               CPU threads (all by default)
  reader.options.uv=mesh  xatlas unwraps a mesh that has no texture coordinates
  fit.*, render.*         the trainer's and the renderer's settings; --cfg job lists them, and what is auto there is
                          decided by the plan, from measurements of the scene
  protocol.*              e.g. protocol.lpips.net=squeeze

Results
  A run is known by the hash of its configuration. One that has finished is not repeated; one that was killed resumes
  from its last checkpoint. Its folder holds metrics.json, curve.csv, config.json, albedo.exr, roughness.exr, light.exr
  and asset.glb.

Exit status: 0 done, 1 it could not be done (one line where a disk or a plugin is to blame, else a traceback),
2 a mistake in what was asked (one line), 130 or 143 interrupted by Ctrl-C or SIGTERM, with the state saved.
IA_BENCH_DEBUG=1 shows every traceback. --version says which code this is.
"""


def usage() -> str:
    """The help text, with built-in and installed choices. Nothing is imported; ``ia_bench.check --help`` tells broken plugins."""
    return TEXT.format(choices="\n".join(_group(group, line) for group, line in GROUPS.items()))


def _group(group: str, line: str) -> str:
    choices = {path.stem: _description(path) for path in sorted((conf_folder() / group).glob("*.yaml"))}
    kind = next((kind for kind in registry.KINDS if kind == group), None)
    if kind is not None:
        choices |= {name: f"from {plugin.distribution}" for name, plugin in registry.installed(kind).items()}
    if group == "scene":
        absent = set(choices) - _scenes_here()
        choices |= {name: f"(not here) {text}" for name, text in choices.items() if name in absent}
    lines = [
        fill(f"{name:<17} {description}", 118, initial_indent=" " * 4, subsequent_indent=" " * 22) + "\n"
        for name, description in choices.items()
    ]
    return f"  {group + '=':<18}{line}\n" + "".join(lines)


def _scenes_here() -> set[str]:
    try:
        return {folder.name for root in scenes_folders() for folder in root.iterdir()}
    except (InputError, OSError):
        return set()


def _description(path: Path) -> str:
    """The comment that follows the command at the top of a YAML file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    command = next(number for number, line in enumerate(lines) if line.startswith("# python -m"))
    return lines[command + 1].removeprefix("#").strip()
