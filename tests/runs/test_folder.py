"""The run folder: what it writes and refuses, its record and checkpoint, and what cannot spoil it."""

import csv
import errno
import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from ia_bench.common.errors import Fault, InputError
from ia_bench.runs import folder as checkpoint
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.record import METRICS_FILE, RunRecord, RunSetup, finished_record

HASH = "a" * 64
CONFIG = {"seed": 0, "fit": {"pixels": 4096, "rates": {"light": 0.1}}}
LABELS: dict[str, Any] = {"row": "none", "scene": "hat", "seed": 0, "protocol": "paper-v1"}


@pytest.fixture
def folder(tmp_path: Path):
    with RunFolder(tmp_path / "runs" / "hat" / "none", CONFIG, HASH) as opened:
        yield opened


def good_record() -> RunRecord:
    metrics = {"albedo": {"psnr": 20.0}, "roughness": {"mse": None}}
    return RunRecord(**LABELS, config_hash=HASH, status="ok", metrics=metrics, reasons={"roughness.mse": "no ground truth"})


def test_failure_is_recorded_in_one_line_and_is_not_finished(folder: RunFolder) -> None:
    folder.save_checkpoint({"step": 3})
    try:
        raise FloatingPointError("albedo stopped being finite at step 7")
    except FloatingPointError as error:
        folder.write_failure(error, LABELS)
    record = json.loads((folder.path / METRICS_FILE).read_text())
    assert (record["status"], record["row"]) == ("failed", "none")
    assert record["error"] == "FloatingPointError: albedo stopped being finite at step 7"
    assert "test_folder.py" in record["traceback"]
    assert folder.finished() is None
    assert folder.load_checkpoint() == {"step": 3}
    # reports list failures line by line; the traceback has all of it
    folder.write_failure(RuntimeError("CUDA error\n\n# set CUDA_LAUNCH_BLOCKING"), LABELS)
    record = json.loads((folder.path / METRICS_FILE).read_text())
    assert (record["error"], "# set" in record["traceback"]) == ("RuntimeError: CUDA error", True)
    folder.write_failure("exit status 1: 10%\r20%", LABELS)  # a bar of a plug-in's, which a log ends with
    assert RunRecord.read(folder.path).error == "exit status 1: 10%\\r20%"


def test_curve_is_csv_with_every_column(folder: RunFolder) -> None:
    rows = [
        {"stage": 1, "step": 25, "seconds": 0.5, "albedo_psnr": 13.25},
        {"stage": 2, "step": 50, "seconds": 1.0, "albedo_psnr": None, "roughness_mse": 0.05},
    ]
    folder.write_curve(rows)
    with (folder.path / "curve.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == ["stage", "step", "seconds", "albedo_psnr", "roughness_mse"]
    assert [row["albedo_psnr"] for row in read] == ["13.25", ""]


def test_another_configuration_is_refused_by_key(folder: RunFolder) -> None:
    path = folder.path
    folder.__exit__(None, None, None)
    other = {"seed": 1, "fit": {"pixels": 4096, "rates": {"light": 0.3}}}
    expected = r"these differ: seed \(0 there, 1 here\), fit\.rates\.light \(0\.1 there, 0\.3 here\)$"
    with pytest.raises(InputError, match=f"holds the results of another configuration; {expected}"):
        RunFolder(path, other, "b" * 64)
    RunFolder(path, CONFIG, HASH).__exit__(None, None, None)  # the refusal left the lock free and the folder whole


def test_a_file_system_without_locks_is_a_plain_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_lustre(*_: object) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(checkpoint.fcntl, "flock", as_lustre)
    with pytest.raises(InputError, match="run: expected a file system on which files can be locked, found: Function not impl"):
        RunFolder(tmp_path / "run", CONFIG, HASH)


def test_folder_that_cannot_be_used_is_a_plain_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be used as a run's folder"):
        RunFolder(tmp_path / "file" / "run", CONFIG, HASH)
    (tmp_path / METRICS_FILE).write_text("{}")
    with pytest.raises(InputError, match=r"holds a metrics\.json but no config\.json"):
        RunFolder(tmp_path, CONFIG, HASH)


def test_a_finished_run_that_lost_a_file_is_none(tmp_path: Path) -> None:
    notes: list[str] = []
    with RunFolder(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.write_bytes("albedo.exr", b"red")
        folder.write_record(good_record())
        assert folder.finished() is not None
        (tmp_path / "preview.png").write_bytes(b"of somebody else")
        assert folder.finished() is not None
        for damage in (lambda path: path.write_bytes(b"rad"), Path.unlink, Path.mkdir):
            damage(tmp_path / "albedo.exr")
            assert folder.finished() is None
    assert notes == [f"{tmp_path}/albedo.exr: not what the run wrote there, or gone; running again"] * 3


FULL_DISK = """
import resource, sys
from pathlib import Path
from ia_bench.runs.folder import RunFolder
import numpy as np, torch
from ia_bench.scenes.exr import write_exr
from ia_bench.common.errors import Fault
def write_map(folder):
    with folder.path_for("albedo.exr") as path:
        write_exr(path, np.random.rand(100, 100, 3).astype(np.float32), half=False)
with RunFolder(Path(sys.argv[1]), {"seed": 0}, "a" * 64) as folder:
    folder.save_checkpoint({"step": 3, "weights": torch.zeros(10)})
    folder.write_bytes("albedo.exr", b"old")
    resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
    folder.save_checkpoint({"step": 4, "weights": torch.zeros(100000)})
    assert folder.load_checkpoint()["step"] == 3
    for write in (lambda: folder.write_bytes("metrics.json", bytes(30000)), lambda: write_map(folder)):
        try:
            write()
        except Fault as error:
            print(error)
try:
    write_exr(Path(sys.argv[1], "map.exr"), np.random.rand(100, 100, 3))
except OSError as error:
    print(error)
"""


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", FULL_DISK, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "cannot be written (File too large); an interruption would cost more than usual" in lines[0]
    assert [line.split(": ")[0].rpartition("/")[2] for line in lines[1:3]] == ["metrics.json", "albedo.exr"]
    assert all(line.endswith("cannot be written (File too large)") for line in lines[1:3])
    assert lines[3:] == [f"[Errno {errno.EFBIG}] File too large: '{tmp_path}/map.exr'"]
    assert (tmp_path / "albedo.exr").read_bytes() == b"old"
    assert not (tmp_path / "metrics.json").exists()
    assert not list(tmp_path.glob(".*.exr"))


def test_a_folder_with_nothing_but_a_failed_run_is_used_again(folder: RunFolder) -> None:
    """After the scene was mended, which makes it another configuration."""
    folder.save_checkpoint({"step": 3})
    folder.write_failure("the scene is broken", LABELS)
    folder.__exit__(None, None, None)
    with RunFolder(folder.path, {"seed": 1}, "b" * 64) as again:
        assert again.load_checkpoint() is None
        again.write_record(good_record())
    with pytest.raises(InputError, match="holds the results of another configuration"):
        RunFolder(folder.path, CONFIG, HASH)


def test_who_is_killed_while_claiming_a_failed_run_may_come_again(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.write_failure("the scene is broken", LABELS)
    folder.__exit__(None, None, None)
    with monkeypatch.context() as patched:
        patched.setattr(RunFolder, "write_bytes", lambda *_: os.kill(os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            RunFolder(folder.path, {"seed": 1}, "b" * 64)
    with RunFolder(folder.path, {"seed": 1}, "b" * 64):
        assert RunSetup.read(folder.path).identity == {"seed": 1}
        assert not (folder.path / METRICS_FILE).exists()


def test_a_run_that_goes_on_says_where_its_files_are_now(folder: RunFolder) -> None:
    """Also after a failure; of a finished one nothing is changed."""
    path = folder.path
    folder.__exit__(None, None, None)
    for place in "bc":
        moved = {"command": f"ia-bench run scene.path=/{place} row=b", "config": {"scene": {"path": f"/{place}"}, "row": "b"}}
        with RunFolder(path, CONFIG, HASH, setup=moved) as again:
            assert (RunSetup.read(path).command, RunSetup.read(path).config) == (moved["command"], moved["config"])
            again.write_failure("the disk is full", LABELS) if place == "b" else again.write_record(good_record())
    RunFolder(path, CONFIG, HASH, setup={"command": "", "config": {}}).__exit__(None, None, None)
    assert RunSetup.read(path).command == moved["command"]


def test_checkpoint_returns_what_it_was_given(folder: RunFolder) -> None:
    assert folder.load_checkpoint() is None
    generator = torch.Generator().manual_seed(3)
    parameter = torch.randn(5, requires_grad=True)
    optimizer = torch.optim.Adam([parameter])
    parameter.sum().backward()
    optimizer.step()
    state = {"step": 7, "name": "stage 1", "parts": [parameter.detach()], "optimizer": optimizer.state_dict()}
    folder.save_checkpoint(state | {"random": generator.get_state()})
    loaded = folder.load_checkpoint()
    assert loaded["step"] == 7
    torch.testing.assert_close(loaded["parts"][0], parameter.detach(), rtol=0, atol=0)
    torch.testing.assert_close(loaded["random"], generator.get_state(), rtol=0, atol=0)
    optimizer.load_state_dict(loaded["optimizer"])


def test_checkpoint_of_other_code_is_reported_and_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    with RunFolder(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"step": 3})
        monkeypatch.setattr(checkpoint, "_code", lambda: "of yesterday")
        assert folder.load_checkpoint() is None
    assert "another version of the code wrote it" in notes[0]


def _flipped(content: bytes, place: int) -> bytes:
    changed = bytearray(content)
    changed[place] ^= 0x10
    return changed


DAMAGE = {
    **{f"truncated to {kept}": lambda content, kept=kept: content[:kept] for kept in (0, 100, -1)},
    **{f"flipped at {place}": partial(_flipped, place=place) for place in (3, 40, 700, -30)},
    "garbage": lambda content: bytes(range(256)) * 40,
    "of torch alone": lambda content: content[len(checkpoint.MAGIC) + checkpoint.DIGEST :],
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_no_bit_of_a_damaged_checkpoint_is_believed(tmp_path: Path, damage: str) -> None:
    notes: list[str] = []
    with RunFolder(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"weights": torch.zeros(1000)})
        assert folder.load_checkpoint() is not None
        path = tmp_path / "checkpoint.pt"
        path.write_bytes(DAMAGE[damage](path.read_bytes()))
        assert folder.load_checkpoint() is None
    assert len(notes) == 1
    assert "checkpoint.pt: checkpoint ignored, starting over" in notes[0]


def test_checkpoint_that_would_run_code_is_ignored(folder: RunFolder) -> None:
    class Code:
        def __reduce__(self):
            return os.system, (f"touch {folder.path}/executed",)

    torch.save({"config_hash": HASH, "state": Code()}, folder.path / "checkpoint.pt")
    assert folder.load_checkpoint() is None
    (folder.path / "checkpoint.pt").write_bytes(checkpoint.pack(Code(), HASH))
    assert folder.load_checkpoint() is None
    assert not (folder.path / "executed").exists()


def test_what_is_written_is_read_and_says_how_far_it_can_be_trusted(folder: RunFolder) -> None:
    written = folder.write_record(good_record())
    assert folder.finished() == written == RunRecord.read(folder.path) == finished_record(folder.path, folder.config_hash)
    assert finished_record(folder.path, "b" * 64) is None
    assert (written.score("albedo.psnr"), written.score("roughness.mse"), written.score("gloss.psnr")) == (20.0, None, None)
    record = replace(good_record(), environment={"commit": "abc", "threads": 1})
    assert (record.clean, record.threads) == (True, 1)
    changed = replace(record, environment={"commit": "abc+changes"})
    assert (changed.clean, changed.threads) == (False, None)
    assert good_record().clean is None  # of no checkout: nobody knows


def test_a_metric_more_or_less_and_a_key_of_a_later_version_are_read(tmp_path: Path) -> None:
    """A new metric changes no line of this room, and a record of before it has simply no such number."""
    content = asdict(good_record()) | {"metrics": {"gloss": {"error": 1.5}}, "weather": "rain"}
    (tmp_path / METRICS_FILE).write_text(json.dumps(content))
    assert (RunRecord.read(tmp_path).score("gloss.error"), RunRecord.read(tmp_path).score("albedo.psnr")) == (1.5, None)


WRONG = [
    ({"schema": 1}, "schema: expected 2, found 1"),
    ({"row": "a\0b"}, "row: expected a name of 1 to 200 printable characters"),
    ({"status": "done"}, "unknown value of status: 'done'"),
    ({"metrics": {}}, "metrics: expected the scores of a finished run, found none"),
    ({"metrics": {"albedo": {"psnr": "20"}}}, "metrics.albedo.psnr: expected "),
    ({"reasons": {}}, "metrics.roughness.mse: expected a number, or why there is none"),
    ({"per_image": {"albedo": 3}}, "per_image.albedo: expected a table"),
    ({"status": "failed"}, "error: expected why the run failed, found nothing"),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[message[:30] for _, message in WRONG])
def test_a_value_of_another_type_is_named_by_file_and_key(tmp_path: Path, change: dict, message: str) -> None:
    (tmp_path / METRICS_FILE).write_text(json.dumps(asdict(good_record()) | change))
    with pytest.raises(InputError) as caught:
        RunRecord.read(tmp_path)
    assert f"{tmp_path / METRICS_FILE}: {message}" in str(caught.value)


def test_pipes_and_devices_are_refused_and_not_waited_for(tmp_path: Path) -> None:
    for name, make in (("pipe", os.mkfifo), ("zero", lambda path: path.symlink_to("/dev/zero"))):
        folder = tmp_path / name
        folder.mkdir()
        make(folder / METRICS_FILE)
        with pytest.raises(InputError, match="expected a file, found a pipe or a device"):
            RunRecord.read(folder)
    with pytest.raises(InputError, match="expected a run's metrics.json, found none"):
        RunRecord.read(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metrics": {"albedo": {"psnr": float("nan")}}}, "psnr: expected a finite number"),
        ({"time_s": {"total": float("inf")}}, "total: expected a finite number"),
        ({"counters": {"steps": None}}, r"counters\.steps: expected"),
        ({"environment": {"where": Path()}}, r"environment\.where: expected .*, found the PosixPath"),
        ({"plan": {"value": float("nan")}}, r"plan\.value: expected a finite number"),
    ],
)
def test_what_nobody_could_read_is_not_written(folder: RunFolder, change: dict, message: str) -> None:
    with pytest.raises(Fault, match=message):
        folder.write_record(replace(good_record(), **change))
    assert not (folder.path / METRICS_FILE).exists()
