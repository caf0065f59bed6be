"""``python -m ia_bench``: one run, or a sweep of runs, from a Hydra configuration. ``--help`` says how."""

from __future__ import annotations

import os
import sys
import traceback
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from ia_bench.cli.usage import usage
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, INTERRUPTED, OK, complain
from ia_bench.common.paths import conf_folder
from ia_bench.runs.composition import CONFIG_NAME, HYDRA_VERSION, explain, register, to_run_config, written_out
from ia_bench.runs.execute import execute


def job(composed: DictConfig) -> dict[str, Any]:
    """One job of Hydra: a single run, or one of a sweep."""
    try:
        metrics = execute(to_run_config(composed))
        print(summary(metrics))
        return metrics
    except InputError as error:
        if HydraConfig.get().mode is RunMode.RUN and not _debugging():
            raise SystemExit(complain(str(error))) from None  # past Hydra, which would put a line of its own before it
        raise


def summary(metrics: dict[str, Any]) -> str:
    """The means of a run, one line per component, under the protocol that decides what they mean."""
    lines = [f"{metrics['row']}, scene {metrics['scene']}, seed {metrics['seed']}, protocol {metrics['protocol']}:"]
    for component, values in metrics["metrics"].items():
        shown = [f"{name} {'undefined' if value is None else format(value, '.4g')}" for name, value in values.items()]
        lines.append(f"  {component:<16}{', '.join(shown)}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = written_out(sys.argv[1:] if arguments is None else arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(usage(), end="")
        return OK
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra hands its errors on instead of printing them and exiting
    # argparse wants its own options together, wherever among the overrides -m was written
    sys.argv[1:] = sorted(arguments, key=lambda text: "=" in text and not text.startswith("-"))
    try:
        register(arguments)
        hydra.main(str(conf_folder()), CONFIG_NAME, version_base=HYDRA_VERSION)(job)()
    except (InputError, HydraException, OmegaConfBaseException) as error:
        if _debugging():
            raise
        return complain(str(error) if isinstance(error, InputError) else explain(error))
    except SystemExit as stop:  # from argparse, or from a job that has said why
        return stop.code if isinstance(stop.code, int) else FAULT
    except FloatingPointError as error:  # a fit that gave up has said what was not finite, and metrics.json says where
        if _debugging():
            raise
        return complain(str(error), FAULT)
    except KeyboardInterrupt:
        print("ia_bench: interrupted; the same command resumes", file=sys.stderr)
        return INTERRUPTED
    except Exception:
        traceback.print_exc()
        return FAULT
    return OK


def _debugging() -> bool:
    return os.environ.get("IA_BENCH_DEBUG") == "1"
