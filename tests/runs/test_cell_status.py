"""How far a table is: every state made by hand, and the time left by arithmetic."""

import json
import os
import time
from pathlib import Path

import pytest
from run_records import write_record

from ia_bench.cli.report import main as report
from ia_bench.cli.watch import main as watch
from ia_bench.common.errors import InputError
from ia_bench.runs.cells import FAILED, FINISHED, RUNNING, WAITING, folders_with_cells, look, read_cells
from ia_bench.runs.folder import find_run_folders, lock_folder

HASH = "0" * 64


def cell(results: Path, row: str, seed: int = 0, /, **record: object) -> Path:
    """The folder of a cell on hat; with a metrics.json where ``record`` has something for it."""
    folder = results / "runs" / "hat" / f"{row}-seed{seed}-00000000"
    folder.mkdir(parents=True)
    config = {"scene": {"name": "hat"}, "seed": seed}
    (folder / "config.json").write_text(json.dumps({"config_hash": HASH, "identity": {}, "config": config}))
    return write_record(folder, row, seed=seed, **{"config_hash": HASH, **record}) if record else folder


def plan(results: Path, *rows: tuple[str, int], jobs: int | None = 2) -> None:
    common = {"scene": "hat", "config_hash": HASH}
    cells = [
        {"row": row, "seed": seed, "folder": f"runs/hat/{row}-seed{seed}-00000000", "log": f"logs/{row}"} | common
        for row, seed in rows
    ]
    results.mkdir(exist_ok=True)
    (results / "cells.json").write_text(json.dumps({"table": "paper", "jobs": jobs, "cells": cells}))


def test_every_state_is_told_from_what_lies_in_the_folders(tmp_path: Path) -> None:
    before = cell(tmp_path, "failed before", status="failed", error="of last week")
    os.utime(before / "metrics.json", (1, 1))
    plan(tmp_path, *((row, 0) for row in ("done", "other", "failed", "failed before", "begun", "running", "absent", "torn")))
    (cell(tmp_path, "torn") / "metrics.json").write_text("{")
    cell(tmp_path, "done", status="ok", time_s={"total": 60.0})
    cell(tmp_path, "other", status="ok", config_hash="1" * 64)
    cell(tmp_path, "failed", status="failed", error="boom")
    cell(tmp_path, "begun")
    running = cell(tmp_path, "running")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "running").write_text("a note\nfit: 1/9, loss 3\nfit: 4/9, loss 2, 3 s left\nanother note\n")
    with lock_folder(running, print):
        found = {one.cell.row: one for one in look(tmp_path).cells}
    waiting = dict.fromkeys(("other", "failed before", "begun", "absent"), WAITING)
    assert {row: one.state for row, one in found.items()} == {
        "done": FINISHED,
        "failed": FAILED,
        "running": RUNNING,
        "torn": FAILED,
    } | waiting
    assert "torn-seed0-00000000/metrics.json" in found["torn"].says
    assert found["done"].seconds == 60
    assert found["failed"].says == "boom"
    assert found["running"].says == "fit: 4/9, loss 2, 3 s left"
    assert {one.cell.row: one.state for one in look(tmp_path).cells}["running"] == WAITING  # nobody holds it any more


def test_the_time_left_is_that_of_the_rows_own_cells_shared_by_the_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Row a took 100 s and row b 40 s. To do: a twice, b once, and c, which is expected to take their mean of 70 s; one of a has
    been at work for 30 s. So 100 + 40 + 70 + 70 s of work for two jobs."""
    plan(tmp_path, ("a", 0), ("b", 0), ("a", 1), ("a", 2), ("b", 1), ("c", 0))
    assert look(tmp_path).seconds_left() is None
    cell(tmp_path, "a", status="ok", time_s={"total": 100.0})
    cell(tmp_path, "b", status="ok", time_s={"total": 40.0})
    running = cell(tmp_path, "a", 1)
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now)
    for path in (tmp_path / "cells.json", running / "config.json"):
        os.utime(path, (now - 900, now - 900))  # begun before, interrupted, and gone on with half a minute ago
    with lock_folder(running, print):
        os.utime(running / ".lock", (now - 30, now - 30))
        assert look(tmp_path).seconds_left() == pytest.approx((100 + 40 + 70 + 70) / 2, abs=2)
        plan(tmp_path, ("a", 0), ("a", 1), jobs=8)
        os.utime(tmp_path / "cells.json", (now - 900, now - 900))
        assert look(tmp_path).seconds_left() == pytest.approx(70, abs=2)  # what one cell takes, no job can shorten


def test_files_of_other_programs_are_no_runs(tmp_path: Path) -> None:
    """Weights have a config.json too."""
    mine = cell(tmp_path, "a", status="ok", time_s={"total": 1.0})
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / "config.json").write_text(json.dumps({"size": 64}))
    assert find_run_folders(tmp_path) == [mine]


def test_a_foreign_cells_json_hides_no_run(tmp_path: Path) -> None:
    notes = list[str]()
    run = tmp_path / "runs" / "mine"
    run.mkdir(parents=True)
    (run / "metrics.json").write_text("{}")
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "cells.json").write_text("[1, 2]")
    assert list(folders_with_cells([tmp_path], notes.append)) == [run]
    assert notes == [f"{tmp_path}/theirs/cells.json: expected a JSON object, found list: passed over"]


def test_what_is_no_table_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected the results of a table, which has a cells\.json, found none"):
        look(tmp_path)
    (tmp_path / "cells.json").write_text('{"table": "paper", "jobs": 1, "cells": [{"row": "a"}]}')
    with pytest.raises(InputError, match=r"cells\.json: expected the cells of a table: cells.0.scene: expected a value"):
        read_cells(tmp_path)
    (tmp_path / "cells.json").write_text('{"table": "paper", "jobs": 1, "cells": [{"raw": "a"}]}')
    with pytest.raises(InputError, match=r"unknown setting 'cells.0.raw'; did you mean 'cells.0.row'\? There are: row, scene,"):
        read_cells(tmp_path)


@pytest.mark.parametrize("key", ["folder", "log"])
@pytest.mark.parametrize("place", ["a\0b", "a" * 300, "../../elsewhere", "/dev/zero"], ids=["NUL", "long", "above", "device"])
def test_a_path_that_no_table_writes_is_told(tmp_path: Path, key: str, place: str, capsys: pytest.CaptureFixture[str]) -> None:
    plan(tmp_path, ("a", 0))
    content = json.loads((tmp_path / "cells.json").read_text())
    content["cells"][0][key] = place
    (tmp_path / "cells.json").write_text(json.dumps(content))
    for command in (watch, report):
        assert command([str(tmp_path)]) == 2
        expected = f"cells.json: expected the cells of a table: cells.0.{key}: expected a path below the table's results, found '"
        assert expected in capsys.readouterr().err
