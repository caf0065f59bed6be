"""How a method talks to the outside, what it ends with, and what a run spends: the part of the contract that needs no renderer."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ia_bench.common.declared import Declared
from ia_bench.common.progress import ProgressBar, unseen

if TYPE_CHECKING:
    from ia_bench.render.reconstruction import Reconstruction

OF_THE_FIT = ("bake",)
"""Entries whose seconds are a cost of the fit all the same."""
NOT_OF_THE_ROW = ("total", "score", "pictures", "capture")
"""Phases of a run that are none of its method."""


@dataclass(frozen=True)
class Result:
    """What a method gives back.

    Attributes:
        reconstruction: What it recovered.
        seconds: By phase, whose names are the method's own; "prior" for what it asked one, or corrected. Baking and scoring
            are no part of it.
        counters: What a reader of the results should know of the fit, such as "network_calls".
        steps: How many steps it took, 0 for a method that takes none.
        declared: What is said of results that were made elsewhere; None for what this run has made.
    """

    reconstruction: Reconstruction
    seconds: Mapping[str, float] = field(default_factory=dict)
    counters: Mapping[str, int] = field(default_factory=dict)
    steps: int = 0
    declared: Declared | None = None


@dataclass(frozen=True)
class Monitor:
    """How a method talks to the outside: progress, off-the-clock scoring, checkpoints.

    A method that raises before it begins a task with what it has loaded starts over without it.

    Attributes:
        task: Begins a bar of the display: its name, steps in all, steps already done.
        note: Takes one-line messages to the user.
        score: Takes phase, step, seconds so far, and what gives what is recovered so far; its time and rays are not counted.
        save: Keeps the state of the fit: tensors, numbers, texts, and lists and dicts of them.
        load: Gives back what was saved last by an interrupted process with the same configuration, or None.
        stopping: Says that the run is to end: the method saves at its next step, and ``save`` does not return.
        checkpoint_seconds: Time between two states that are saved.
        elsewhere: Says how many seconds so far are in other accounts than the method's, such as those of baking.
    """

    task: Callable[[str, int, int], ProgressBar]
    note: Callable[[str], None]
    score: Callable[[str, int, float, Callable[[], Reconstruction]], None]
    save: Callable[[dict[str, Any]], None]
    load: Callable[[], dict[str, Any] | None]
    stopping: Callable[[], bool] = lambda: False
    checkpoint_seconds: float = 15.0
    elsewhere: Callable[[], float] = lambda: 0.0

    @classmethod
    def silent(cls, **parts: Any) -> Monitor:  # noqa: ANN401 (what the attributes are)
        """A monitor that shows and keeps nothing, but for the ``parts`` that are given."""
        nothing = {name: lambda *_: None for name in ("note", "score", "save", "load")}
        return cls(**{"task": lambda name, steps, done: unseen(name, steps), **nothing, **parts})


class CostTracker:
    """The accounts of one run, those of the processes before an interruption included.

    Seconds spent inside an :meth:`exclude` block are booked under that entry, and its rays and points are not counted. CPU seconds
    of such a block are left out too, but for those of baking, which belong to the fit. A block inside another belongs to the outer.

    Attributes:
        seconds: Entry -> seconds.
        cpu_left_out: CPU seconds that are none of the fit's; negative for what it has spent in earlier processes.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._count: Callable[[], Mapping[str, int]] = dict
        self._left_out: Counter[str] = Counter()  # of what is counted; negative for what earlier processes had counted
        self._inside = False
        self._started = time.perf_counter()
        self.cpu_left_out = time.process_time()

    def watch(self, count: Callable[[], Mapping[str, int]]) -> None:
        """Counts come from ``count`` from now on: name -> how many so far."""
        self._count = count

    @contextmanager
    def exclude(self, entry: str) -> Iterator[None]:
        """Book what happens inside under ``entry``."""
        if self._inside:
            yield
            return
        self._inside, before = True, Counter(self._count())
        started, cpu_started = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self._inside = False
            self.seconds[entry] = self.seconds.get(entry, 0.0) + time.perf_counter() - started
            if entry not in OF_THE_FIT:
                self.cpu_left_out += time.process_time() - cpu_started
            self._left_out.update(self._count())
            self._left_out.subtract(before)

    def counts(self) -> dict[str, int]:
        """Name -> how many the fit has taken."""
        return {name: count - self._left_out[name] for name, count in self._count().items()}

    def total(self) -> float:
        """Seconds of the whole run."""
        return time.perf_counter() - self._started

    def cpu_seconds(self) -> float:
        """CPU seconds of all threads of the fit, baking included; what else runs on the machine hardly changes them."""
        return time.process_time() - self.cpu_left_out

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {"seconds": dict(self.seconds), "counts": self.counts(), "total": self.total(), "cpu_seconds": self.cpu_seconds()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from :meth:`state`; what this process has done so far repeated what is in it already."""
        self.seconds = dict(state["seconds"])
        self._started = time.perf_counter() - state["total"]
        self.cpu_left_out = time.process_time() - state["cpu_seconds"]
        self._left_out = Counter(self._count())
        self._left_out.subtract(state["counts"])
