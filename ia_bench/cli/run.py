"""``python -m ia_bench``: one run, or a sweep of runs, from a Hydra configuration. ``--help`` says how."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, fields

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ia_bench.cli.usage import usage
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, INTERRUPTED, OK, TERMINATED, complain, status_of
from ia_bench.common.output import say
from ia_bench.common.paths import conf_folder
from ia_bench.runs.composition import CONFIG_NAME, HYDRA_VERSION, compose, explain, register, to_run_config, written_out
from ia_bench.runs.config import RunConfig
from ia_bench.runs.execute import execute
from ia_bench.runs.record import RunRecord


class JobFailed(RuntimeError):
    """A job of a sweep has said what went wrong; the others go on. The argument is its exit status."""


def job(composed: DictConfig) -> None:
    """One job of Hydra: a single run, or one of a sweep."""

    def work() -> int:
        say(summary(execute(to_run_config(composed))), sys.stdout)
        return OK

    status = status_of(work)
    if status in (INTERRUPTED, TERMINATED) or (status != OK and HydraConfig.get().mode is RunMode.RUN):
        raise SystemExit(status)  # past Hydra, which would put a line of its own before it
    if status != OK:
        raise JobFailed(status)


def summary(record: RunRecord) -> str:
    """The means of a run, one line per component, under the protocol that decides what they mean."""
    lines = [f"{record.row}, scene {record.scene}, seed {record.seed}, protocol {record.protocol}:"]
    for component, values in record.metrics.items():
        shown = [f"{name} {'undefined' if value is None else format(value, '.4g')}" for name, value in values.items()]
        lines.append(f"  {component:<16}{', '.join(shown)}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = written_out(sys.argv[1:] if arguments is None else arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        say(usage().rstrip(), sys.stdout)
        return OK
    mistaken = _no_setting(arguments)
    if mistaken is not None:
        return complain(mistaken)
    if arguments[-2:] == ["--cfg", "job"]:  # as it will be checked, with the options of the method and its preset in it
        return status_of(lambda: _show(arguments[:-2]))
    if not any(text.lstrip("+~").startswith(("-", "hydra")) for text in arguments):  # Hydra's own way to one run composes it twice
        return status_of(lambda: _run(arguments))
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra hands its errors on instead of printing them and exiting
    # argparse wants its own options together, wherever among the overrides -m was written
    sys.argv[1:] = sorted(arguments, key=lambda text: "=" in text and not text.startswith("-"))
    return status_of(lambda: _compose_and_run(arguments))


def _no_setting(arguments: list[str]) -> str | None:
    """What to write in place of a setting without its =, ``scene hat`` or ``--scene hat``; None where there is none."""
    known = {field.name for field in fields(RunConfig)}
    for place, text in enumerate(arguments):
        name = text.lstrip("-")
        if "=" in name or name.split(".")[0] not in known or (text.startswith("-") and not text.startswith("--")):
            continue
        value = next((after for after in arguments[place + 1 : place + 2] if "=" not in after), "VALUE")
        return f"{text}: expected SETTING=VALUE, such as {name}={value}, found no ="
    return None


def _run(arguments: list[str]) -> int:
    say(summary(execute(compose(arguments))), sys.stdout)
    return OK


def _show(arguments: list[str]) -> int:
    say(OmegaConf.to_yaml(OmegaConf.create(asdict(compose(arguments)))).rstrip(), sys.stdout)
    return OK


def _compose_and_run(arguments: list[str]) -> int:
    try:
        register(arguments)
        hydra.main(str(conf_folder()), CONFIG_NAME, version_base=HYDRA_VERSION)(job)()
    except JobFailed as failed:
        return int(failed.args[0])
    except SystemExit as stop:  # from argparse, or from a job that has said why
        return stop.code if isinstance(stop.code, int) else FAULT
    except (HydraException, OmegaConfBaseException, OSError, ValueError) as error:  # the last two of settings of Hydra itself
        if isinstance(error, InputError):
            raise
        raise InputError(explain(error)) from error
    return OK
