"""Processes that make training data side by side, one thread each."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from ia_bench.common.errors import Fault
from ia_bench.common.machine import settle_libraries


def share_out(work: Callable[..., None], jobs: Sequence[tuple[Any, ...]], *, workers: int) -> Iterator[int]:
    """Call ``work(*job)`` for every job in at most ``workers`` processes; yield the numbers of jobs as they are done.

    ``work`` is a function of a module; what it raises is raised here, and the jobs that have not begun are given up. Raises
    Fault where a process ended before its job did.
    """
    spawn = multiprocessing.get_context("spawn")  # a forked copy of torch's thread pools may hang
    pool = ProcessPoolExecutor(max(1, min(workers, len(jobs))), spawn, _begin)
    try:
        pending = {pool.submit(work, *job): number for number, job in enumerate(jobs)}
        for done in as_completed(pending):
            done.result()
            yield pending[done]
    except BrokenProcessPool:
        killed = "a worker process was killed, as systems do where memory runs out"
        raise Fault(f"{killed}; the same command goes on, with fewer workers= if it happens again") from None
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """One thread, and an end when the parent ends."""
    settle_libraries(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
