"""The run folder: what it writes, what it refuses, and that neither kill -9 nor a second process can spoil it."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.common.machine import environment
from ia_bench.runs.folder import METRICS, METRICS_KEYS, RecordError, RunFolder, check_metrics, finished_metrics

HASH = "a" * 64
CONFIG = {"seed": 0, "fit": {"pixels": 4096, "rates": {"light": 0.1}}}
LABELS = {"row": "none", "scene": "hat", "seed": 0, "protocol": "paper-v1"}


def good_metrics() -> dict:
    return {
        "schema": 1,
        **LABELS,
        "config_hash": HASH,
        "status": "ok",
        "metrics": {"albedo": {"psnr": 20.0}, "roughness": {"mse": None}},
        "reasons": {"roughness.mse": "no ground truth"},
        "per_image": {"albedo": {"psnr": [20.0]}},
        "time_s": {"total": 1.0},
        "peak_memory_bytes": 1,
        "rays": 1,
        "network_calls": 0,
        "plan": {"needed": [], "left_out": []},
        "environment": {},
    }


@pytest.fixture
def folder(tmp_path: Path):
    with RunFolder.open(tmp_path / "runs" / "hat" / "none", CONFIG, HASH) as opened:
        yield opened


def test_finished_only_after_metrics(folder: RunFolder) -> None:
    assert folder.finished() is None
    folder.save_checkpoint({"step": 3})
    folder.write_metrics(good_metrics())
    assert folder.finished() == good_metrics()
    assert folder.load_checkpoint() is None, "a finished run needs no checkpoint"
    assert finished_metrics(folder.path, "b" * 64) is None


@pytest.mark.parametrize("key", METRICS_KEYS)
def test_metrics_lacking_a_key_are_refused(folder: RunFolder, key: str) -> None:
    metrics = good_metrics()
    del metrics[key]
    with pytest.raises(RecordError, match=key):
        folder.write_metrics(metrics)
    assert not (folder.path / METRICS).exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metrics": {"albedo": {"psnr": float("nan")}}}, r"albedo\.psnr: is nan"),
        ({"metrics": {"albedo": {"psnr": float("inf")}}}, r"albedo\.psnr: is inf"),
        ({"per_image": {"albedo": {"psnr": [1.0, float("nan")]}}}, r"per_image\.albedo\.psnr\[1\]: is nan"),
        ({"metrics": {"albedo": {"psnr": None}}, "reasons": {}}, r"albedo\.psnr: is null without a reason"),
        ({"metrics": {"albedo": {"psnr": "20"}}}, r"albedo\.psnr: expected a number, found '20'"),
        ({"metrics": {"albedo": {"psnr": True}}}, "expected a number"),
        ({"rays": None}, "rays: expected int, found None"),
        ({"seed": True}, "seed: expected int, found True"),
        ({"seed": "0"}, "seed: expected int, found '0'"),
        ({"schema": 2}, "schema: expected 1, found 2"),
        ({"status": "done"}, "status: expected 'ok' or 'failed', found 'done'"),
        ({"config_hash": "b" * 64}, "config_hash: expected aaa"),
        ({"environment": {"where": Path()}}, "not JSON serializable"),
    ],
)
def test_metrics_that_are_wrong_are_refused_by_key(folder: RunFolder, change: dict, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        folder.write_metrics(good_metrics() | change)
    assert not (folder.path / METRICS).exists()


def test_a_null_with_its_reason_is_fine() -> None:
    check_metrics(good_metrics() | {"rays": None, "reasons": {"rays": "not counted", "roughness.mse": "no truth"}})


def test_failure_is_recorded_and_is_not_finished(folder: RunFolder) -> None:
    folder.save_checkpoint({"step": 3})
    try:
        raise FloatingPointError("albedo stopped being finite at step 7")
    except FloatingPointError as error:
        folder.write_failure(error, LABELS)
    record = json.loads((folder.path / METRICS).read_text())
    assert (record["status"], record["row"]) == ("failed", "none")
    assert record["error"] == "FloatingPointError: albedo stopped being finite at step 7"
    assert "test_folder.py" in record["traceback"]
    assert folder.finished() is None
    assert folder.load_checkpoint() == {"step": 3}


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
    assert loaded is not None
    assert loaded["step"] == 7
    torch.testing.assert_close(loaded["parts"][0], parameter.detach(), rtol=0, atol=0)
    torch.testing.assert_close(loaded["random"], generator.get_state(), rtol=0, atol=0)
    optimizer.load_state_dict(loaded["optimizer"])


def test_checkpoint_of_other_code_is_reported_and_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    with RunFolder.open(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"step": 3})
        monkeypatch.setattr("ia_bench.runs.folder.CHECKPOINT_FORMAT", -1)
        assert folder.load_checkpoint() is None
    assert "another version of the code wrote it" in notes[0]


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.99])
def test_truncated_checkpoint_is_reported_and_ignored(tmp_path: Path, kept: float) -> None:
    notes: list[str] = []
    with RunFolder.open(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"weights": torch.zeros(1000)})
        path = tmp_path / "checkpoint.pt"
        whole = path.read_bytes()
        path.write_bytes(whole[: int(kept * len(whole)) if isinstance(kept, float) else kept])
        assert folder.load_checkpoint() is None
    assert len(notes) == 1
    assert "checkpoint.pt: checkpoint ignored, starting over" in notes[0]


def test_checkpoint_that_would_run_code_is_ignored(folder: RunFolder) -> None:
    class Code:
        def __reduce__(self):
            return os.system, (f"touch {folder.path}/executed",)

    torch.save({"config_hash": HASH, "state": Code()}, folder.path / "checkpoint.pt")
    assert folder.load_checkpoint() is None
    assert not (folder.path / "executed").exists()


def test_file_is_replaced_whole_or_not_at_all(folder: RunFolder) -> None:
    folder.write_bytes("albedo.exr", b"old")

    def write_half() -> None:
        with folder.path_for("albedo.exr") as path:
            path.write_bytes(b"ha")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_half()
    assert (folder.path / "albedo.exr").read_bytes() == b"old"
    assert not list(folder.path.glob(".tmp-*"))


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
    with pytest.raises(RecordError, match=r"curve\.csv\[0\]: albedo_psnr: is nan"):
        folder.write_curve([{"stage": 1, "step": 1, "seconds": 0.1, "albedo_psnr": float("nan")}])


def test_another_configuration_is_refused_by_key(folder: RunFolder) -> None:
    path = folder.path
    folder.__exit__(None, None, None)
    other = {"seed": 1, "fit": {"pixels": 4096, "rates": {"light": 0.3}}}
    expected = r"these differ: seed \(0 there, 1 here\), fit\.rates\.light \(0\.1 there, 0\.3 here\)$"
    with pytest.raises(InputError, match=f"holds the results of another configuration; {expected}"):
        RunFolder.open(path, other, "b" * 64)
    RunFolder.open(path, CONFIG, HASH).__exit__(None, None, None)  # the refusal left the lock free and the folder whole


def test_folder_that_cannot_be_used_is_a_plain_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be used as a run's folder"):
        RunFolder.open(tmp_path / "file" / "run", CONFIG, HASH)
    (tmp_path / METRICS).write_text("{}")
    with pytest.raises(InputError, match=r"holds a metrics\.json but no config\.json"):
        RunFolder.open(tmp_path, CONFIG, HASH)


def test_leftovers_of_a_killed_writer_are_removed(folder: RunFolder) -> None:
    (folder.path / ".tmp-albedo.exr").write_bytes(b"ha")
    path = folder.path
    folder.__exit__(None, None, None)
    with RunFolder.open(path, CONFIG, HASH):
        assert not list(path.glob(".tmp-*"))


def test_files_of_others_are_left_alone(folder: RunFolder, tmp_path: Path) -> None:
    """A run that goes on below the folder is writing its own; a folder that is refused is not touched at all."""
    mine, below = tmp_path / ".tmp-mine", folder.path / "nested" / ".tmp-checkpoint.pt"
    below.parent.mkdir()
    for path in (mine, below):
        path.write_bytes(b"half")
    folder.__exit__(None, None, None)
    RunFolder.open(folder.path, CONFIG, HASH).__exit__(None, None, None)
    (tmp_path / METRICS).write_text("{}")
    with pytest.raises(InputError, match="not a run's folder"):
        RunFolder.open(tmp_path, CONFIG, HASH)
    assert mine.exists()
    assert below.exists()


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"config_hash": 1}'])
def test_a_config_that_is_no_runs_is_a_plain_error(tmp_path: Path, content: str) -> None:
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(InputError, match=r"config\.json: (not valid JSON|expected a )"):
        RunFolder.open(tmp_path, CONFIG, HASH)


WRITER = """
import sys
from ia_bench.runs.folder import RunFolder
from pathlib import Path
with RunFolder.open(Path(sys.argv[1]), {"seed": 0}, "a" * 64) as folder:
    print("ready", flush=True)
    for number in range(10**9):
        folder.write_json("big.json", {"number": number, "filler": list(range(20000))})
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


def test_second_process_waits_for_the_first(tmp_path: Path) -> None:
    notes: list[str] = []
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()

    def note_and_release(text: str) -> None:
        notes.append(text)
        process.kill()  # the kernel releases the lock of a process that is gone

    with RunFolder.open(tmp_path, {"seed": 0}, HASH, note_and_release):
        pass
    process.wait()
    process.stdout.close()
    assert len(notes) == 1
    assert "another process is working on this run; waiting" in notes[0]


def test_environment_is_json_and_names_versions() -> None:
    found = json.loads(json.dumps(environment("cpu", 2), allow_nan=False))
    assert found["packages"]["torch"] == torch.__version__
    assert found["threads"] == 2
    assert found["memory_bytes"] > 1 << 28
