"""metrics.json as one typed record: what is written is read, what is none is one sentence, and nothing hangs."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from run_folders import good_content, good_record

from ia_bench.common.errors import Fault, InputError
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.record import CONFIG, METRICS_FILE, RunRecord, RunSetup, finished_record


def test_what_is_written_is_read(folder: RunFolder) -> None:
    written = folder.write_record(good_record())
    assert folder.finished() == written == RunRecord.read(folder.path) == finished_record(folder.path, folder.config_hash)
    assert finished_record(folder.path, "b" * 64) is None
    assert (written.score("albedo.psnr"), written.score("roughness.mse"), written.score("gloss.psnr")) == (20.0, None, None)


def test_a_metric_more_or_less_and_a_key_of_a_later_version_are_read(tmp_path: Path) -> None:
    """A new metric changes no line of this room, and a record of before it has simply no such number."""
    content = good_content() | {"metrics": {"gloss": {"error": 1.5}}, "weather": "rain"}
    (tmp_path / METRICS_FILE).write_text(json.dumps(content))
    assert (RunRecord.read(tmp_path).score("gloss.error"), RunRecord.read(tmp_path).score("albedo.psnr")) == (1.5, None)


def test_how_far_a_record_can_be_trusted_stands_in_it() -> None:
    record = replace(good_record(), environment={"commit": "abc", "threads": 1})
    assert (record.commit, record.clean, record.threads) == ("abc", True, 1)
    changed = replace(record, environment={"commit": "abc+changes"})
    assert (changed.commit, changed.clean, changed.threads) == ("abc", False, None)
    assert not good_record().clean  # of no checkout: nobody knows


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
    (tmp_path / METRICS_FILE).write_text(json.dumps(good_content() | change))
    with pytest.raises(InputError) as caught:
        RunRecord.read(tmp_path)
    assert f"{tmp_path / METRICS_FILE}: {message}" in str(caught.value)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"reader": "x"}, "config.reader: expected a table, found 'x'"),
        ({"method": {"options": [1]}}, "config.method.options: expected a"),
    ],
)
def test_a_part_of_a_configuration_that_is_no_table_is_named(tmp_path: Path, config: dict, message: str) -> None:
    (tmp_path / CONFIG).write_text(json.dumps({"config_hash": "0", "identity": {}, "config": config}))
    with pytest.raises(InputError, match=f"{CONFIG}: expected the configuration of a run: {message}"):
        RunSetup.read(tmp_path)


def test_pipes_and_devices_are_refused_and_not_waited_for(tmp_path: Path) -> None:
    for name, make in (("pipe", os.mkfifo), ("zero", lambda path: path.symlink_to("/dev/zero"))):
        folder = tmp_path / name
        folder.mkdir()
        make(folder / METRICS_FILE)
        with pytest.raises(InputError, match="expected a file, found a pipe or a device"):
            RunRecord.read(folder)
    with pytest.raises(FileNotFoundError):
        RunRecord.read(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metrics": {"albedo": {"psnr": float("nan")}}}, "psnr: expected a finite number"),
        ({"time_s": {"total": float("inf")}}, "total: expected a finite number"),
        ({"counters": {"steps": None}}, r"counters\.steps: expected"),
        ({"environment": {"where": Path()}}, "PosixPath is not JSON serializable"),
        ({"plan": {"value": float("nan")}}, r"plan\.value: expected a finite number"),
    ],
)
def test_what_nobody_could_read_is_not_written(folder: RunFolder, change: dict, message: str) -> None:
    with pytest.raises(Fault, match=message):
        folder.write_record(replace(good_record(), **change))
    assert not (folder.path / METRICS_FILE).exists()
