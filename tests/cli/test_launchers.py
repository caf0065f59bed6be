"""Every launcher makes the same table of the same cells, workers that die included; settings; what Slurm is told.

Cells are real processes in which fake_run stands for the run. Ray and submitit are extras: without one, its cases are
skipped. Slurm's commands are those of fake_slurm.
"""

import fcntl
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from command_line import HERE, started

from ia_bench.cli.table import main, parse
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import INTERRUPTED, TERMINATED
from ia_bench.common.progress import Progress
from ia_bench.runs.cells import Cell, make_cells
from ia_bench.runs.composition import compose
from ia_bench.runs.config import resolved
from ia_bench.runs.launchers import LAUNCHERS, Ray, SubmititSlurm
from ia_bench.runs.schedule import _failed, run_cells
from ia_bench.runs.table import Row, Table

pytestmark = pytest.mark.usefixtures("workplace")
ROWS = {"killed": "prior=none", "crash": "prior=oracle", "raise": "method=ceiling", "good": "method=constant"}


def needs(package: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(importlib.util.find_spec(package) is None, reason=f"needs the extra: pip install -e '.[{package}]'")


REMOTE = [
    pytest.param("submitit_local", marks=[needs("submitit"), pytest.mark.slow]),
    pytest.param("ray", marks=[needs("ray"), pytest.mark.slow]),
]
EVERY = ["local", *REMOTE]


def run(*arguments: str, rows: tuple[str, ...] = tuple(ROWS), jobs: int = 2) -> tuple[list[Cell], int]:
    """Run one cell of each of the rows; the cells, and how many failed."""
    request = parse(["device=cpu", *arguments])
    cells = make_cells(Table(scenes=["hat"], rows=[Row(row, [ROWS[row]]) for row in rows]), request, 1, Path("results/t"))
    with Progress() as progress:
        return cells, run_cells(cells, request.launcher, jobs, progress)


def metrics(cell: Cell) -> dict:
    return json.loads((cell.folder / "metrics.json").read_text())


@pytest.mark.parametrize("launcher", EVERY)
def test_a_worker_that_dies_costs_its_cell_one_attempt(launcher: str, capfd: pytest.CaptureFixture[str]) -> None:
    """`killed` dies by SIGKILL in the middle and resumes, `crash` dies whenever it is started, `raise` fails by itself."""
    cells, failed = run(f"launcher={launcher}", "launcher.attempts=2")
    assert failed == 2
    killed, crash, raised, good = map(metrics, cells)
    assert [one["status"] for one in (killed, crash, raised, good)] == ["ok", "failed", "failed", "ok"]
    assert killed["metrics"] == good["metrics"], "as if nothing had happened: no step twice, none left out"
    assert "resumed at 20" in next(Path("results/t/logs").glob("hat-killed-*.log")).read_text()
    assert "RuntimeError: boom" in next(Path("results/t/logs").glob("hat-raise-*.log")).read_text()
    assert crash["error"].startswith("worker died: ")
    assert crash["error"].endswith("; 2 attempts")
    assert sorted(started()) == ["hat crash 0"] * 2 + ["hat good 0"] + ["hat killed 0"] * 2 + ["hat raise 0"]
    out, said = capfd.readouterr()
    assert out == ""
    for line in (
        "hat / killed / seed 0: worker died: ", "hat / killed / seed 0: ok",
        "hat / crash / seed 0: worker died: ", "hat / crash / seed 0: FAILED (worker died: ",
        "hat / raise / seed 0: FAILED (exit status 1: RuntimeError: boom), see results/t/logs/hat-raise-",
        "hat / good / seed 0: ok", "table: 4/4, failed 2",
    ):  # fmt: skip
        assert f"\n{line}" in f"\n{said}"
    assert said.count("; attempt 2 of 2") == 2
    assert "Traceback" not in said

    cells, failed = run("launcher=local", "launcher.attempts=1", rows=("killed", "good"))  # finished is finished, wherever it was
    assert failed == 0
    assert "2 of 2 cells are finished already" in capfd.readouterr().err


@pytest.mark.parametrize("launcher", REMOTE)
@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, TERMINATED), (signal.SIGINT, INTERRUPTED)])
def test_an_interrupted_table_ends_its_jobs_with_their_state_saved(launcher: str, number: int, status: int) -> None:
    environment = os.environ | {"FAKE_HOLD": "never"}
    command = [sys.executable, "-m", "ia_bench", "table", f"launcher={launcher}", "scenes=hat", "jobs=1", "device=cpu"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    deadline = time.monotonic() + 1200
    while time.monotonic() < deadline and not list(Path("results").rglob("checkpoint.pt")):
        time.sleep(0.05)
    process.send_signal(number)
    _, said = process.communicate(timeout=1200)
    assert process.returncode == status, said
    assert "ending 1 cells; they save their state first" in said
    assert "interrupted; the same command resumes" in said
    (checkpoint,) = Path("results").rglob("checkpoint.pt")
    assert list(Path("results").rglob("metrics.json")) == []
    (log,) = Path("results/paper/logs").glob("hat-*.log")
    while "interrupted" not in log.read_text():  # a busy machine is late, and nobody was killed
        assert time.monotonic() < deadline
        time.sleep(0.05)
    with (checkpoint.parent / ".lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody is at work there any more


@needs("ray")
@pytest.mark.slow
def test_ray_that_is_not_there_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["device=cpu", "scenes=hat", "launcher=ray", "launcher.address=127.0.0.1:1"]) == 2
    assert "launcher.address=127.0.0.1:1: expected a running Ray, found none" in capfd.readouterr().err


@needs("submitit")
def test_slurm_gets_one_array_and_every_setting(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("PATH", f"{HERE / 'fake_slurm'}:{os.environ['PATH']}")
    monkeypatch.setattr(SubmititSlurm, "poll_seconds", 0.1)
    monkeypatch.setattr(SubmititSlurm, "delay_seconds", 0.0)
    own = {"cpus": 2, "memory_gb": 3, "minutes": 90, "partition": "cpu", "account": "me", "options.qos": "low"}
    settings = [f"launcher.{key}={value}" for key, value in own.items()]
    cells, failed = run("launcher=submitit_slurm", "launcher.attempts=1", *settings, rows=("raise", "good", "crash"), jobs=3)
    said = capfd.readouterr().err
    assert failed == 2, said
    assert [metrics(cell)["status"] for cell in cells] == ["failed", "ok", "failed"]
    (script,) = Path("results/t/logs/submitit").glob("100_submission.sh")
    asked = {line.removeprefix("#SBATCH --") for line in script.read_text().splitlines() if line.startswith("#SBATCH")}
    expected = {"array=0-2%3", "cpus-per-task=2", "mem=3GB", "time=90", "partition=cpu", "account=me", "qos=low"}
    assert expected | {"job-name=ia_bench"} <= asked


@needs("submitit")
def test_slurm_that_is_not_there_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["device=cpu", "scenes=hat", "launcher=submitit_slurm"]) == 2
    assert 'launcher=submitit_slurm: Could not detect "srun"' in capfd.readouterr().err


def test_ray_without_its_extra_is_one_sentence_and_with_it_cells_use_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ia_bench.cli.table.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"launcher=ray needs an extra: pip install 'ia_bench\[ray\]'"):
        parse(["launcher=ray"])
    monkeypatch.setattr("ia_bench.cli.table.find_spec", lambda name: name)
    request = parse(["launcher=ray", "launcher.gpus=1", "launcher.cpus=3"])
    assert request.overrides == ("device=cuda",)
    for own in ("device=cpu", "++device=cpu"):
        assert parse(["launcher=ray", "launcher.gpus=1", own]).overrides == (own,)
    (cell,) = make_cells(Table(scenes=["hat"], rows=[Row("a", ["prior=none"])]), request, 3, Path("results/t"))
    assert (cell.config.device, cell.config.threads) == ("cuda", 3)
    assert Ray(cpus=3).jobs_and_threads(None, "cuda")[1] == 3
    assert _failed(cell, "worker died", 0).startswith("FAILED (worker died), see "), "here, where no GPU needs to be"
    assert metrics(cell)["error"] == "worker died"


@pytest.mark.parametrize("row", [["prior=none", "fit.pixels=77"], ["prior=diffusion"], ["method=ceiling"]])
def test_a_worker_resolves_a_configuration_to_itself(row: list[str]) -> None:
    config = compose([*row, "scene=hat", "device=cpu", "threads=1"])
    assert resolved(json.loads(json.dumps(asdict(config)))) == config


def test_every_launcher_has_its_settings_described() -> None:
    page = (HERE.parents[1] / "docs" / "clusters.md").read_text(encoding="utf-8")
    for name, kind in LAUNCHERS.items():
        assert f"`{name}`" in page
        assert all(f"`{field.name}`" in page for field in fields(kind)), name
