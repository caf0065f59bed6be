"""One resolved configuration, run in its folder, whatever state that folder is in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ia_bench.common import registry
from ia_bench.common.errors import Fault, InputError
from ia_bench.common.machine import limit_threads
from ia_bench.common.progress import Progress
from ia_bench.runs.config import RunConfig, labels
from ia_bench.runs.folder import CHECKPOINT, RunFolder
from ia_bench.runs.identity import given, hash_of, identity, run_folder
from ia_bench.runs.interruption import deferred
from ia_bench.runs.metrics import METRICS_FILE


def execute(config: RunConfig) -> dict[str, Any]:
    """Run one resolved configuration in its folder and return its metrics; those of a finished run are read.

    Whatever goes wrong is recorded in the folder as a failed run, and raised; what a plugin raised as a Fault that names it.
    """
    content = identity(config)
    place, key = run_folder(config), hash_of(content)
    with Progress() as progress, RunFolder.open(place, content, key, progress.note, given(config)) as folder:
        metrics = folder.finished()
        if metrics is not None:
            progress.note(f"{folder.path}: already finished, nothing to do")
            return metrics
        progress.note(f"{folder.path}: scene {config.scene.name}, row {config.row_name}, seed {config.seed}")
        try:
            with deferred():
                limit_threads(config.threads or 1)
                metrics = _resume_or_start(config, folder, progress)
        except KeyboardInterrupt as stop:
            if not (folder.path / CHECKPOINT).is_file():  # while a mesh was made of photographs, for instance
                stop.args = (" before the run had saved anything; the same command starts over",)
            raise
        except (Exception, SystemExit) as error:
            failure = _named(error, config)
            try:
                folder.write_failure(failure, labels(config))
            except Fault as problem:
                progress.note(str(problem))
            raise failure from failure.__cause__
        progress.note(f"{folder.path / METRICS_FILE}: done")
        return metrics


def _resume_or_start(config: RunConfig, folder: RunFolder, progress: Progress) -> dict[str, Any]:
    """Do the run; a checkpoint that its method cannot go on from is no checkpoint."""
    from ia_bench.runs.run import run  # brings in the renderer; a finished run does without it

    try:
        return run(config, folder, progress)
    except Exception as error:
        if not folder.restoring:
            raise
        progress.note(f"{folder.path}: checkpoint ignored, starting over ({type(error).__name__}: {error})")
        folder.drop_checkpoint()
        return run(config, folder, progress)


def _named(error: BaseException, config: RunConfig) -> BaseException:
    """``error`` as a Fault that says whose it is, where a plugin or sys.exit is behind it."""
    if isinstance(error, InputError | Fault):
        return error
    modules = set()
    trace = error.__traceback__
    while trace is not None:
        modules.add(trace.tb_frame.f_globals.get("__name__", "").split(".")[0])
        trace = trace.tb_next
    plugin = next((f"{name}: " for name, package in _plugins(config) if package in modules), "")
    what = f"{type(error).__name__}: {error}".split("\n")[0]
    if isinstance(error, SystemExit):
        what = f"sys.exit({error.code!r}) was called in the middle of a run"
    elif not plugin:
        return error
    fault = Fault(plugin + what)
    fault.__cause__ = error
    return fault


def _plugins(config: RunConfig) -> Iterator[tuple[str, str]]:
    """What of the run is not built in, as the command line calls it, and the package that it comes from."""
    parts = [("reader", config.reader.target), ("prior", config.prior.target), ("method", config.method.target)]
    if isinstance(of := config.prior.options.get("of"), str):
        parts.append(("prior.options.of", registry.find("prior", of).target))
    for key, target in parts:
        package = target.partition(":")[0].split(".")[0]
        if package != "ia_bench":
            yield f"{key}={target}", package
