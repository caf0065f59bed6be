"""Progress of long work: Rich bars on a terminal, plain lines every few seconds when the output goes elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TaskID, TextColumn
from rich.progress import Progress as RichProgress

from ia_bench.common.exit_codes import log, say

LINE_SECONDS = 5.0  # at most one line of progress in this time where the output is no terminal


class ProgressBar:
    """Work of a known number of steps, shown by :meth:`Progress.task`."""

    def __init__(self, name: str, total: int, done: int, unit: str, show: Callable[[ProgressBar], None]) -> None:
        """Start the clock; ``done`` steps were made before (by a run that this one resumes) and count in no rate."""
        self.name, self.total, self.done = name, total, done
        self.values: dict[str, float] = {}
        self._first, self._start, self._unit, self._show = done, time.monotonic(), unit, show

    def advance(self, amount: int = 1, **values: float) -> None:
        """Count steps done, and show ``values`` (the current loss, say) beside them until others replace them."""
        self.done += amount
        self.values |= values
        self._show(self)

    @property
    def status(self) -> str:
        """Values, rate and time left as they are shown, e.g. ``loss 0.123, 28 steps/s, 12 s left``."""
        shown = [f"{name} {value:.4g}" for name, value in self.values.items()]
        elapsed, made = time.monotonic() - self._start, self.done - self._first
        if made and elapsed > 0:
            rate = made / elapsed
            shown.append(f"{rate:.3g} {self._unit}s/s" if rate >= 1 else f"{duration(1 / rate)}/{self._unit}")
            shown.append(f"{duration((self.total - self.done) / rate)} left" if self.done < self.total else "done")
        return ", ".join(shown)


class Progress:
    """Shows tasks and notes on ``stream`` (standard error by default, so that results alone go to standard output).

    >>> with Progress() as progress:  # doctest: +SKIP
    ...     task = progress.task("stage 1", total=400)
    ...     task.advance(1, loss=0.123)
    """

    def __init__(self, stream: TextIO | None = None, *, quiet: bool = False) -> None:
        """Bars if ``stream`` is a terminal, else lines; ``quiet``: neither, and notes are logged."""
        self._quiet = quiet
        self._stream = stream
        self._rich: RichProgress | None = None
        self._bars: dict[ProgressBar, TaskID] = {}
        self._last_line = -LINE_SECONDS
        shown_on = sys.stderr if stream is None else stream
        if not quiet and shown_on is not None and shown_on.isatty():
            name, status = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[status]}"))
            columns = (SpinnerColumn(), name, BarColumn(), MofNCompleteColumn(), status)
            self._rich = RichProgress(*columns, console=Console(file=stream, stderr=True), refresh_per_second=4)

    def __enter__(self) -> Progress:
        """Start drawing."""
        if self._rich is not None:
            self._rich.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Leave the last state of every bar on the screen."""
        if self._rich is not None:
            with suppress(OSError):
                self._rich.stop()

    def task(self, name: str, total: int, done: int = 0, unit: str = "step") -> ProgressBar:
        """Begin a task of ``total`` steps, of which ``done`` are made already; ``unit``: what a step is, in the singular."""
        task = ProgressBar(name, total, done, unit, self._show)
        if self._rich is not None:
            self._bars[task] = self._rich.add_task(name, total=total, completed=done, status="")
        elif total > done:
            self._show(task)  # the first step may take long
        return task

    def note(self, text: str) -> None:
        """Say something in one line: a decision of the plan, a fallback."""
        if self._quiet:
            log.info("%s", text)
            return
        if self._rich is None:
            say(text, sys.stderr if self._stream is None else self._stream)  # which a plugin may have closed in between
            return
        with suppress(OSError):  # of a terminal that is gone
            self._rich.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _show(self, task: ProgressBar) -> None:
        if self._rich is not None:
            self._rich.update(self._bars[task], completed=task.done, status=task.status)
        elif not self._quiet and (task.done >= task.total or time.monotonic() - self._last_line >= LINE_SECONDS):
            self._last_line = time.monotonic()
            self.note(", ".join(filter(None, (f"{task.name}: {task.done}/{task.total}", task.status))))


Begin = Callable[[str, int], ProgressBar]
"""Begins a task of a name and so many steps, as :meth:`Progress.task` does."""


def unseen(name: str, total: int) -> ProgressBar:
    """A task that nobody is shown, for work that is asked for without a :class:`Progress`."""
    return ProgressBar(name, total, 0, "step", lambda task: None)


def duration(seconds: float) -> str:
    """A time in the two largest units that matter: ``8 s``, ``3 min 20 s``, ``2 h 5 min``.

    >>> duration(200)
    '3 min 20 s'
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if whole >= 10 or whole == seconds else f"{seconds:.1f} s"
    minutes, left = divmod(whole, 60)
    return f"{minutes} min {left} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
