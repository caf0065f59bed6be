"""Commands whose arguments are the settings of one piece of work, of which they show the progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from ia_bench.common.arguments import read_arguments
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress

T = TypeVar("T")


def command_of(usage: str, kind: type[T], do: Callable[[T, Progress], object]) -> Callable[..., int]:
    """The ``main`` of a command: it runs a command line (None: that of this process) and returns its exit status.

    ``kind`` is a dataclass of the settings, which ``do`` takes.
    """

    def work(given: Sequence[str]) -> int:
        settings = read_arguments(kind, given)
        with Progress() as progress:
            do(settings, progress)
        return OK

    def main(arguments: Sequence[str] | None = None) -> int:
        return command(lambda: usage, work, arguments, resumes=True)

    return main
