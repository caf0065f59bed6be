"""Steps depend on their number alone, a state that cannot be used is refused, and validations end where the state does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench_training.resuming import (
    STATE,
    VALIDATIONS,
    batch_index,
    forget_validations_after,
    identity,
    load_state,
    save_state,
    write_validation,
)


def test_a_folder_is_the_same_however_its_path_is_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert identity({"data": Path("a"), "batch": 2}) == identity({"batch": 2, "data": tmp_path / "a"})
    assert identity({"data": Path("a")}) != identity({"data": Path("b")})


def test_every_image_is_seen_once_in_every_pass() -> None:
    images, batch = 10, 4
    seen = torch.cat([batch_index(images, batch, 3, step) for step in range(5)])
    for epoch in range(2):
        assert sorted(seen[epoch * images : (epoch + 1) * images].tolist()) == list(range(images))
    assert not torch.equal(seen[:images], seen[images:])
    assert torch.equal(batch_index(images, batch, 3, 4), seen[16:])


def test_validations_beyond_the_last_checkpoint_are_forgotten(tmp_path: Path) -> None:
    forget_validations_after(500, tmp_path)  # of a run that has none yet
    for step in (250, 500, 750):
        write_validation(tmp_path, step, 1.0, {"figure": 0.5})
    path = tmp_path / VALIDATIONS
    path.write_text(path.read_text() + '{"step": 10')
    forget_validations_after(500, tmp_path)
    expected = [{"step": step, "seconds": 1.0, "figure": 0.5} for step in (250, 500)]
    assert [json.loads(line) for line in path.read_text().splitlines()] == expected


def test_a_state_comes_back_to_the_run_that_left_it(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert load_state(folder, "mine") is None
    save_state(folder, "mine", {"weight": torch.arange(3.0)})
    state = load_state(folder, "mine")
    assert state is not None
    assert state["weight"].tolist() == [0, 1, 2]
    with pytest.raises(InputError, match=r"state\.pt: belongs to a run with other settings"):
        load_state(folder, "another's")
    (folder / STATE).write_bytes((folder / STATE).read_bytes()[:100])
    with pytest.raises(InputError, match=r"state\.pt: expected the state of a training run, found a file that cannot be read"):
        load_state(folder, "mine")
    torch.save([1, 2, 3], folder / STATE)
    with pytest.raises(InputError, match=r"state\.pt: expected format 4, found None; choose another out=FOLDER"):
        load_state(folder, "mine")
