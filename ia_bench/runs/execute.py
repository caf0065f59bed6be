"""One resolved configuration, run in its folder, whatever state that folder is in."""

from __future__ import annotations

from typing import Any

from ia_bench.common.machine import limit_threads
from ia_bench.common.progress import Progress
from ia_bench.runs.config import RunConfig, hash_of, identity, labels, run_folder
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.metrics import METRICS


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
            from ia_bench.runs.run import run  # brings in the renderer; a finished run does without it

            metrics = run(config, folder, progress)
        except Exception as error:
            folder.write_failure(error, labels(config))
            raise
        progress.note(f"{folder.path / METRICS}: done")
        return metrics
