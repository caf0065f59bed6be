"""Puts a tiny `run` in the place of ia_bench.runs.run, for tests of everything around it.

Python imports a module of this name at start-up: a test puts this folder on PYTHONPATH of the process that it starts.
In its own process it executes this file. Either way nothing happens unless FAKE_LOG is set.
"""

import os
import signal
import sys
import time
import types
from pathlib import Path


def run(config, folder, progress, known):
    """A fit of 40 steps with a checkpoint after each; its result depends on every step having been made once.

    FAKE_LOG is a file that gets a line whenever it starts. With FAKE_HOLD it waits after its third step until it is told to end, or
    that file is there: however slow the machine, a test comes in time. The row "crash" dies by signal, "killed" does so at step 20
    unless it has resumed there, "raise" raises, "refused" raises for a mistake of the user's, "stuck" never comes to a step.
    """
    from ia_bench.runs import interruption
    from ia_bench.runs.record import RunRecord

    with Path(os.environ["FAKE_LOG"]).open("a") as log:
        log.write(f"{config.scene.name} {config.row_name} {config.seed}\n")
    if config.row == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    if config.row == "stuck":
        interruption.GRACE_SECONDS = 1
        time.sleep(3600)
    if config.row == "raise":
        raise RuntimeError("boom")
    if config.row == "refused":
        from ia_bench.common.errors import InputError

        raise InputError("capture.views=800: expected at most 16")
    state = folder.load_checkpoint() or {"step": 0, "value": config.seed}
    if state["step"]:
        progress.note(f"resumed at {state['step']}")
    folder.restoring = False
    task = progress.task("stage 1", total=40, done=state["step"])
    first = state["step"]
    while state["step"] < 40:
        while "FAKE_HOLD" in os.environ and state["step"] == first + 3 and not interruption.asked():
            if Path(os.environ["FAKE_HOLD"]).exists():
                break
            time.sleep(0.01)
        state = {"step": state["step"] + 1, "value": (state["value"] * 6364136223846793005 + state["step"]) % 2**61}
        folder.save_checkpoint(state)
        task.advance(1, loss=1 / state["step"])
        if config.row == "killed" and state["step"] == 20:
            os.kill(os.getpid(), signal.SIGKILL)
    folder.write_curve([{"stage": 1, "step": 40, "seconds": 0.5, "albedo_psnr": 20.0}])
    metrics = {"albedo": {"psnr": 20.0 + config.seed, "value": state["value"]}}
    return folder.write_record(RunRecord(**known, config_hash="", status="ok", metrics=metrics, time_s={"total": 1.0}))


def install() -> None:
    """Make `from ia_bench.runs.run import run` find the run above."""
    module = types.ModuleType("ia_bench.runs.run")
    module.run = run
    sys.modules["ia_bench.runs.run"] = module


if "FAKE_LOG" in os.environ:
    install()
