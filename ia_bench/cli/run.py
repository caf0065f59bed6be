"""``ia-bench run``: one run, from a Hydra configuration. ``--help`` says how."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, command, say
from ia_bench.common.paths import conf_folder

if TYPE_CHECKING:
    from ia_bench.runs.config import RunConfig

SHOW = ["--cfg", "job"]
"""What shows every setting and runs nothing, as with any program of Hydra."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    from ia_bench.cli.usage import usage

    return command(usage, _work, arguments, resumes=True)


def _work(arguments: list[str]) -> int:
    if "--version" in arguments:
        from importlib.metadata import version

        from ia_bench.common.machine import commit

        say(" ".join(filter(None, ("ia_bench", version("ia_bench"), commit()))), sys.stdout)
        return OK
    if "--choices" in arguments:
        from ia_bench.cli.usage import choices

        say(choices().rstrip(), sys.stdout)
        return OK
    if show := "--cfg" in arguments:
        place = arguments.index("--cfg")
        if arguments[place : place + 2] != SHOW:
            raise InputError(f"--cfg: expected {' '.join(SHOW)}, found {' '.join(arguments[place : place + 2])}")
        del arguments[place : place + 2]
    for number, text in enumerate(arguments):
        _expect_setting(text, arguments[number + 1 : number + 2])
    from ia_bench.runs.composition import compose  # brings in Hydra, and what a run is made of

    config = compose(arguments)
    if show:
        from dataclasses import asdict

        from omegaconf import OmegaConf

        settings = asdict(config)
        del settings["command"]
        say(OmegaConf.to_yaml(OmegaConf.create(settings)).rstrip(), sys.stdout)
        return OK
    return run(config)


def run(config: RunConfig) -> int:
    """Do the run of a configuration, say what came of it, and return the exit status."""
    from ia_bench.runs.execute import execute

    record, folder = execute(config)
    say(f"{record.summary()}\n{folder}: ia-bench report {shlex.quote(str(folder))} --open shows it", sys.stdout)
    return OK


def _expect_setting(text: str, after: Sequence[str]) -> None:
    """Raise InputError, with what to write instead, for an argument that is no SETTING=VALUE; ``after``: the next one."""
    name = text.lstrip("-+~")
    if text in ("-m", "--multirun"):
        raise InputError(f"{text}: expected one run, found a sweep: a table is many, ia-bench table --help")
    if name.startswith("hydra"):
        raise InputError(f"{text}: expected a setting of a run, found one of Hydra's own, which decide nothing here")
    if text and (conf_folder() / "scene" / f"{text}.yaml").is_file():
        raise InputError(f"{text}: expected SETTING=VALUE, such as scene={text}")
    if "=" not in text or text.startswith("-"):
        value = next((word for word in after if "=" not in word), "VALUE")
        raise InputError(f"{text}: expected SETTING=VALUE, such as {name.partition('=')[0]}={value}; --help lists them")
