"""A watch beside a table that is really made: two cells of the tiny scene, from the first look to the last number."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SEEN = ("running", "curves", "finished")


@pytest.mark.slow
def test_the_cells_of_a_real_table_are_seen_to_wait_run_and_finish(tmp_path: Path) -> None:
    place = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    results = tmp_path / "results" / "ablations"
    overrides = ["table=ablations", "scenes=tiny", "preset=smoke", "device=cpu", "jobs=1"]
    making = subprocess.Popen(
        [sys.executable, "-m", "ia_bench", "table", *overrides], cwd=tmp_path, env=place, stderr=subprocess.PIPE, text=True
    )
    watch = None
    try:
        until(lambda: (results / "cells.json").is_file(), making)
        watch = subprocess.Popen(
            [sys.executable, "-m", "ia_bench", "watch", "results/ablations", "--every", "0.2"], cwd=tmp_path, env=place
        )
        seen: set[str] = set()

        def enough() -> bool:
            one = news(results)
            if one is not None:
                seen.update(cell[3] for cell in one["cells"])
                seen.update(["curves"] if one["curves"] else [])
                seen.update(["left"] if one["left"] is not None else [])
            return {*SEEN, "left"} <= seen

        until(enough, making)
        assert "waiting" in seen
        assert "failed" not in seen
        making.send_signal(signal.SIGINT)
        making.communicate(timeout=1200)
        watch.send_signal(signal.SIGINT)
        assert watch.wait(timeout=1200) == 0
        last = news(results)
        assert last is not None
        finished = {(row, scene, seed) for row, scene, seed, state, *_ in last["cells"] if state == "finished"}
        records = [json.loads(path.read_text()) for path in results.rglob("metrics.json")]
        assert finished == {(one["row"], one["scene"], one["seed"]) for one in records if one["status"] == "ok"}
        assert last["ended"]
    finally:
        for process in filter(None, (making, watch)):
            process.kill()


def news(results: Path) -> dict[str, Any] | None:
    path = results / "live" / "parts" / "live.js"
    return json.loads(path.read_text().removeprefix("bench.news(").removesuffix(");\n")) if path.is_file() else None


def until(is_so: Any, making: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 1200
    while not is_so():
        assert making.poll() is None, making.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
