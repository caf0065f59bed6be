"""What does not fit into memory is told before it is allocated."""

from __future__ import annotations

import os

import pytest

from ia_bench.common import machine
from ia_bench.common.errors import InputError


def test_available_memory_is_some_and_no_more_than_there_is() -> None:
    assert 0 < machine.available_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def test_a_need_beyond_it_is_named_with_both_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "available_memory", lambda: 8_000_000_000)
    machine.expect_memory("render.texture=2048", 5e8)
    with pytest.raises(InputError, match=r"render\.texture=100000: expected .* the 8\.0 GB .*, found a need for 1\.28e\+03 GB"):
        machine.expect_memory("render.texture=100000", 1.28e12)
