"""What a command says as it ends."""

from __future__ import annotations

import errno

import pytest

from ia_bench.common.exit_codes import FAULT, status_of


def test_a_full_disk_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise OSError(errno.ENOSPC, "No space left on device", "results/report.md")

    assert status_of(work) == FAULT
    assert capsys.readouterr().err == "ia_bench: [Errno 28] No space left on device: 'results/report.md'\n"
