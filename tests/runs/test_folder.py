"""The run folder: what it writes, what it refuses, and that neither kill -9 nor a second process can spoil it."""

from __future__ import annotations

import csv
import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from run_folders import CONFIG, HASH, LABELS, good_record

from ia_bench.common.errors import InputError
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.record import METRICS_FILE


def test_failure_is_recorded_and_is_not_finished(folder: RunFolder) -> None:
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
"""


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", FULL_DISK, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "cannot be written (File too large); an interruption would cost more than usual" in lines[0]
    assert [line.split(": ")[0].rpartition("/")[2] for line in lines[1:]] == ["metrics.json", "albedo.exr"]
    assert all("cannot be written" in line for line in lines)
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


WRITER = """
import json, sys
from ia_bench.runs.folder import RunFolder
from pathlib import Path
with RunFolder(Path(sys.argv[1]), {"seed": 0}, "a" * 64) as folder:
    print("ready", flush=True)
    for number in range(10**9):
        folder.write_bytes("big.json", json.dumps({"number": number, "filler": list(range(20000))}).encode())
"""


def test_kill_9_while_writing_leaves_a_whole_file(tmp_path: Path) -> None:
    for trial in range(4):
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        while not (tmp_path / "big.json").is_file() and process.poll() is None:  # a busy machine is late with the first one
            time.sleep(0.01)
        time.sleep(0.05 + random.Random(trial).random() * 0.1)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert len(json.loads((tmp_path / "big.json").read_text())["filler"]) == 20000
