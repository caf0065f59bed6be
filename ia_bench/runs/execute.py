"""One resolved configuration, run in its folder, whatever state that folder is in."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

from ia_bench.common.errors import Fault, InputError, PluginError, raised
from ia_bench.common.machine import settle_libraries
from ia_bench.common.progress import Progress
from ia_bench.runs.config import RunConfig
from ia_bench.runs.folder import CHECKPOINT, RunFolder
from ia_bench.runs.identity import hash_of, identity, labels, run_folder, setup
from ia_bench.runs.interruption import deferred
from ia_bench.runs.record import RunRecord


def execute(config: RunConfig, progress: Progress | None = None) -> tuple[RunRecord, Path]:
    """Run one resolved configuration and return its record and its folder; the record of a finished run is read.

    ``progress``: what shows the work, None for one of its own.

    Whatever goes wrong is recorded in the folder as a failed run, and raised; what a plugin raised as a PluginError that names it.
    A mistake in what was asked for leaves no folder behind, unless that was asked for, too.
    """
    content = identity(config)
    key = hash_of(content)
    place = run_folder(config, key)
    showing = Progress() if progress is None else nullcontext(progress)
    with showing as progress, RunFolder(place, content, key, progress.note, setup(config)) as folder:
        record = folder.finished()
        if record is not None:
            progress.note(f"{folder.path}: already finished, nothing to do")
            return record, place
        progress.note(f"{folder.path}: scene {config.scene.name}, row {config.row_name}, seed {config.seed}")
        try:
            with deferred():
                settle_libraries(config.threads or 1)
                from ia_bench.runs.run import run  # brings in the renderer; a finished run does without it

                known = labels(config, content)
                try:
                    record = run(config, folder, progress, known)
                except Exception as error:
                    if not folder.restoring:
                        raise
                    progress.note(f"{folder.path}: checkpoint ignored, starting over ({raised(error)})")
                    folder.drop_checkpoint()
                    record = run(config, folder, progress, known)
        except KeyboardInterrupt as stop:
            if record is not None:
                stop.args = (" when the run had just finished; the same command shows its scores",)
            elif not (folder.path / CHECKPOINT).is_file():  # while a mesh was made of photographs, for instance
                stop.args = (" before the run had saved anything; the same command starts over",)
            raise
        except Exception as error:
            refused = isinstance(error, InputError) and not isinstance(error, PluginError)
            if refused and config.out is None and folder.forget():
                raise
            try:
                folder.write_failure(error, labels(config, content))
            except Fault as problem:
                progress.note(str(problem))
            raise
        return record, place
