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

from ia_bench.composition import CONFIG_NAME, HYDRA_VERSION, explain, register, to_run_config, written_out
from ia_bench.config import RunConfig, hash_of, identity, labels, run_folder
from ia_bench.errors import InputError
from ia_bench.paths import conf_folder
from ia_bench.progress import Progress
from ia_bench.records import METRICS, RunFolder
from ia_bench.usage import usage

OK, FAULT, MISTAKE, INTERRUPTED = 0, 1, 2, 130


def execute(config: RunConfig) -> dict[str, Any]:
    """Run one resolved configuration in its folder and return its metrics; those of a finished run are read.

    Whatever goes wrong is recorded in the folder as a failed run, and raised.
    """
    content = identity(config)
    with Progress() as progress, RunFolder.open(run_folder(config), content, hash_of(content), progress.note) as folder:
        metrics = folder.finished()
        if metrics is not None:
            progress.note(f"{folder.path}: already finished, nothing to do")
            return metrics
        progress.note(f"{folder.path}: scene {config.scene.name}, row {config.row_name}, seed {config.seed}")
        try:
            limit_threads(config.threads or 1)
            from ia_bench.run import run  # brings in the renderer; a finished run does without it

            metrics = run(config, folder, progress)
        except Exception as error:
            folder.write_failure(error, labels(config))
            raise
        progress.note(f"{folder.path / METRICS}: done")
        return metrics


def limit_threads(threads: int) -> None:
    """Make every library of this process use ``threads`` CPU threads."""
    os.environ["OMP_NUM_THREADS"] = str(threads)  # for what is not loaded yet, and for child processes
    import torch

    torch.set_num_threads(threads)


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


def complain(message: str, status: int = MISTAKE) -> int:
    """Print one message and return the exit status, which is that of a mistake unless said otherwise."""
    print(f"ia_bench: {message}", file=sys.stderr)
    return status


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


if __name__ == "__main__":
    sys.exit(main())
