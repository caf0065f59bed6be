"""How a loop of steps talks to the outside, and what it ends with: the part of the contract that needs no renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ia_bench.common.declared import Declared
from ia_bench.common.progress import ProgressBar, unseen

if TYPE_CHECKING:
    from ia_bench.render.reconstruction import Reconstruction


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
    """

    task: Callable[[str, int, int], ProgressBar]
    note: Callable[[str], None]
    score: Callable[[str, int, float, Callable[[], Reconstruction]], None]
    save: Callable[[dict[str, Any]], None]
    load: Callable[[], dict[str, Any] | None]
    stopping: Callable[[], bool] = lambda: False
    checkpoint_seconds: float = 15.0

    @classmethod
    def silent(cls, **parts: Any) -> Monitor:  # noqa: ANN401 (what the attributes are)
        """A monitor that shows and keeps nothing, but for the ``parts`` that are given."""
        nothing = {name: lambda *_: None for name in ("note", "score", "save", "load")}
        return cls(**{"task": lambda name, steps, done: unseen(name, steps), **nothing, **parts})
