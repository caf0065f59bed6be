"""Checkpoints: no bit of a damaged one is believed, and what stays is stored once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch
from run_folders import CONFIG, HASH

from ia_bench.runs import folder as checkpoint
from ia_bench.runs.folder import RunFolder


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
    with RunFolder(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"step": 3})
        monkeypatch.setattr(checkpoint, "_code", lambda: "of yesterday")
        assert folder.load_checkpoint() is None
    assert "another version of the code wrote it" in notes[0]


def _checkpoint_with(part: Path, change) -> None:
    content = bytearray(part.read_bytes())
    changed = change(content)
    part.write_bytes(content if changed is None else changed)


def _flip(place: int):
    def flip(content: bytearray) -> None:
        content[place % len(content)] ^= 0x10

    return flip


DAMAGE = {
    **{f"truncated to {kept}": lambda content, kept=kept: content[:kept] for kept in (0, 100, -1)},
    **{f"flipped at {place}": _flip(place) for place in (3, 40, 700, -30)},
    "garbage": lambda content: bytes(range(256)) * 40,
    "of torch alone": lambda content: content[len(checkpoint.MAGIC) + checkpoint.DIGEST :],
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_no_bit_of_a_damaged_checkpoint_is_believed(tmp_path: Path, damage: str) -> None:
    notes: list[str] = []
    with RunFolder(tmp_path, CONFIG, HASH, notes.append) as folder:
        folder.save_checkpoint({"weights": torch.zeros(1000)})
        assert folder.load_checkpoint() is not None
        _checkpoint_with(tmp_path / "checkpoint.pt", DAMAGE[damage])
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
