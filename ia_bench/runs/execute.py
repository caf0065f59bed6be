"""One resolved configuration, run in its folder, whatever state that folder is in."""

from __future__ import annotations

from typing import Any

from ia_bench.common.errors import Fault
from ia_bench.common.machine import limit_threads
from ia_bench.common.progress import Progress
from ia_bench.runs.config import RunConfig, labels
from ia_bench.runs.folder import CHECKPOINT, RunFolder
from ia_bench.runs.identity import given, hash_of, identity, run_folder
from ia_bench.runs.interruption import deferred
from ia_bench.runs.metrics import METRICS_FILE


def execute(config: RunConfig) -> dict[str, Any]:
    """Run one resolved configuration in its folder and return its metrics; those of a finished run are read.

    Whatever goes wrong is recorded in the folder as a failed run, and raised; what a plugin raised as a PluginError that names it.
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
        except Exception as error:
            try:
                folder.write_failure(error, labels(config))
            except Fault as problem:
                progress.note(str(problem))
            raise
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
