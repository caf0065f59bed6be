"""Progress on a terminal and in a pipe."""

import io

import pytest

from ia_bench.common import progress as module
from ia_bench.common.progress import Progress, duration


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_piped_output_is_clean_occasional_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(0.05 * tick for tick in range(10_000))  # twice a step is asked for the time
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress.note("plan: shadow rays [needed]")
        task = progress.task("stage 1", total=400)
        for step in range(400):
            task.advance(1, loss=1 / (step + 1))
    text = stream.getvalue()
    assert not [c for c in text if ord(c) < 32 and c != "\n"]
    lines = text.splitlines()
    assert lines[0] == "plan: shadow rays [needed]"
    assert lines[-1].startswith("stage 1: 400/400, loss 0.0025, ")
    assert 5 <= len(lines) <= 12, "40 seconds by this clock, a line every 5"
    assert " left" in lines[2]


def test_terminal_shows_loss_and_time_left() -> None:
    stream = Terminal()
    with Progress(stream) as progress:
        task = progress.task("stage [1]", total=4)
        task.advance(1, loss=0.123)
        task.advance(1, loss=0.125)
        progress.note("no compiler: eager")
    assert "\x1b[" in stream.getvalue()
    assert "0.125" in stream.getvalue()
    assert "stage [1]" in stream.getvalue()
    assert "no compiler: eager" in stream.getvalue()


def test_rate_of_a_resumed_task_counts_only_its_own_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    task = Progress(io.StringIO()).task("stage 1", total=100, done=90)
    now[0] = 1.0
    task.advance(2)
    assert task.status == "2 steps/s, 4 s left"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.25, "0.2 s"), (8, "8 s"), (59.7, "1 min 0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")]
)
def test_duration(seconds: float, text: str) -> None:
    assert duration(seconds) == text
