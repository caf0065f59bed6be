"""The table's orchestration: which cells there are, that a crash stays in its cell, and that nothing runs twice.

Cells are real processes of `python -m ia_bench` in which tests/fake_run stands for the run.
"""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import started

from ia_bench.cli import table as table_module
from ia_bench.cli.table import main, parse
from ia_bench.common.errors import Fault, InputError
from ia_bench.common.paths import conf_folder
from ia_bench.common.progress import Progress
from ia_bench.runs import cells as module
from ia_bench.runs import launchers
from ia_bench.runs.cells import TableRequest, make_cells
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.launchers import Local
from ia_bench.runs.record import finished_record
from ia_bench.runs.schedule import run_cells
from ia_bench.runs.table import Row, Table, load_table

HERE = Path(__file__).parent
SHIPPED = ("hat", "ship", "console", "figurine", "tiny")


pytestmark = pytest.mark.usefixtures("workplace")


def cells_of(table: Table, broken=None, **request) -> list[module.Cell]:
    return make_cells(table, TableRequest(overrides=("device=cpu",), **request), 1, Path("results/paper"), broken)


def hat_with(row: str, override: str) -> list[module.Cell]:
    """The cells of this row, and of one that is good."""
    return cells_of(Table(scenes=["hat"], rows=[Row(row, [override]), Row("good", ["prior=none"])]))


def failures(cells: list[module.Cell]) -> int:
    with Progress() as progress:
        return run_cells(cells, Local(attempts=1), 1, progress)


@pytest.mark.parametrize("path", sorted(conf_folder().glob("table/*.yaml")), ids=lambda path: path.stem)
def test_shipped_table_is_well_formed(path: Path) -> None:
    table = load_table(path.stem)
    command = "# make table " if path.stem == "paper" else f"# ia-bench table table={path.stem}\n"
    assert path.read_text().startswith(command)
    scenes = tuple(one if one in SHIPPED else "hat" for one in table.scenes[:1])  # photographs and renders may be absent
    every_row = replace(table, captures=table.captures[:1], rows=[replace(row, captures=None) for row in table.rows])
    every_capture = replace(table, rows=[replace(table.rows[0], captures=None)])
    for part in (every_row, every_capture) if table.captures else (table,):  # and not each with each, which takes long
        cells = cells_of(part, scenes=scenes)
        assert len(cells) == len(part.crossed_rows) * len(scenes) * len(table.seeds)
        assert len({cell.config_hash for cell in cells}) == len(cells), "two rows with one configuration say nothing"
        assert len({cell.folder for cell in cells}) == len(cells)


def test_a_row_whose_plugin_is_broken_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [Row("fine", ["prior=none"]), Row("broken", ["method=json:loads"])]
    told: list[str] = []
    cells = cells_of(Table(scenes=["hat"], rows=rows), told.append)
    assert [cell.row for cell in cells] == ["fine"]
    (line,) = told
    assert line.startswith("broken: left out: method 'json:loads'")
    assert "\n" not in line
    with pytest.raises(InputError, match="cannot be used"):
        cells_of(Table(scenes=["hat"], rows=rows))


def test_command_line_is_told_apart_and_a_cell_is_the_run_that_its_own_makes() -> None:
    overrides = ("preset=smoke", "protocol.lpips.net=squeeze")
    request = parse(["table=ablations", "seeds=0,1", "scenes=hat,ship", "jobs=2", *overrides])
    assert request == TableRequest("ablations", ("hat", "ship"), (0, 1), 2, overrides)
    assert parse(["jobs=auto"]) == parse([]) == TableRequest()
    cells = cells_of(load_table("ablations"), scenes=("ship",), seeds=(3,))
    (cell,) = [one for one in cells if one.row == "diffusion, targets w/o guided"]
    again = compose(cell.config.command)
    assert again == cell.config
    assert (again.seed, again.scene.name, again.threads) == (3, "ship", 1)
    assert str(cell.folder).startswith("results/paper/runs/ship/diffusion-targets-w-o-guided-seed3-")


@pytest.mark.parametrize(("given", "threads"), [([], 4), (["threads=3"], 3), (["++threads=3"], 3)])
def test_a_cell_gets_its_share_of_the_cores_and_settings_that_its_row_knows(
    given: list[str], threads: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The precision is a setting of the diffusion prior, which the row sets, and of no prior there is else."""
    monkeypatch.setattr(launchers.os, "sched_getaffinity", lambda _: set(range(8)))
    own = ["jobs=2", "rows=diffusion, kernel", "scenes=hat", "prior.options.precision=bf16", "device=cpu", *given]
    monkeypatch.setattr(table_module, "run_cells", lambda cells, *_: seen.extend(cells) or len(cells))
    monkeypatch.setattr(table_module, "write_cells", lambda *_: None)
    seen: list[module.Cell] = []
    main(["table=ablations", *own])
    assert [cell.config.threads for cell in seen] == [threads]
    assert seen[0].config.prior.options["precision"] == "bf16"
    assert f"{threads} threads each" in capfd.readouterr().err


def test_threads_share_the_cores_and_depend_on_the_machine_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launchers.os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(launchers, "total_memory", lambda: 64 << 30)
    assert Local().jobs_and_threads(None, "cpu") == (8, 1)
    assert Local().jobs_and_threads(3, "cpu") == (3, 2)
    assert Local().jobs_and_threads(None, "cuda") == (1, 8)
    monkeypatch.setattr(launchers, "total_memory", lambda: 7 << 30)
    assert Local().jobs_and_threads(None, "cpu") == (2, 4)
    monkeypatch.setattr(launchers, "total_memory", lambda: 1 << 30)
    assert Local().jobs_and_threads(None, "cpu") == (1, 8)


def test_a_cell_whose_record_is_damaged_fails_alone_and_keeps_it(capfd: pytest.CaptureFixture[str]) -> None:
    cells = hat_with("torn", "method=ceiling")
    record = cells[0].folder / "metrics.json"
    record.parent.mkdir(parents=True)
    record.write_text('{"status": "ok"}')
    for _ in range(2):  # with something left to do, and without
        assert failures(cells) == 1
        said = capfd.readouterr().err
        assert f"hat / torn / seed 0: FAILED ({record}: " in said
    assert record.read_text() == '{"status": "ok"}'
    assert (cells[1].folder / "metrics.json").is_file()


@pytest.mark.slow
def test_a_cell_whose_files_are_damaged_runs_again() -> None:
    cells = hat_with("torn", "method=ceiling")
    for _ in range(2):
        assert failures(cells) == 0
        assert len(started()) == 2, "what has finished is not run again"
    curve = cells[0].folder / "curve.csv"
    whole = curve.read_bytes()
    curve.write_bytes(whole[:-3])
    assert failures(cells) == 0
    assert sorted(started()) == ["hat good 0", "hat torn 0", "hat torn 0"]
    assert curve.read_bytes() == whole


def test_a_cell_that_cannot_say_why_fails_alone(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    def full(self: RunFolder, problem: str, labels: object) -> None:
        raise Fault("metrics.json: No space left on device")

    monkeypatch.setattr(RunFolder, "write_failure", full)
    cells = hat_with("crash", "prior=oracle")
    assert failures(cells) == 1
    said = capfd.readouterr().err
    assert "hat / crash / seed 0: FAILED (metrics.json: No space left on device)" in said
    assert "hat / good / seed 0: ok" in said


@pytest.mark.slow
def test_whole_table_on_the_tiny_scene(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """Every row for real, and the report from what they leave; a second call only writes the report again."""
    monkeypatch.delenv("FAKE_LOG")
    monkeypatch.delenv("IA_BENCH_DATASETS")
    monkeypatch.setenv("PYTHONPATH", str(HERE.parents[1]))
    rows = [row.name for row in load_table("paper").rows if not any("preset=" in override for override in row.overrides)]
    arguments = ["scenes=tiny", "preset=smoke", "device=cpu", f"rows={','.join(rows)}"]
    assert main(arguments) == 0, capfd.readouterr().err
    said = capfd.readouterr().out
    assert all(row in said for row in rows)
    results = Path("results/paper")
    for name in ("report.md", "table.tex", "table.csv", "runs.csv"):
        assert (results / name).stat().st_size > 0
    files = sorted(results.rglob("metrics.json"))
    times = [path.stat().st_mtime_ns for path in files]
    assert len(files) == len(rows)
    assert main(arguments) == 0
    assert [path.stat().st_mtime_ns for path in files] == times
    (folder,) = results.glob("runs/tiny/none-seed0-*")
    config_hash = json.loads((folder / "config.json").read_text())["config_hash"]
    assert finished_record(folder, config_hash) is not None
