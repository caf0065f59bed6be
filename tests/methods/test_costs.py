"""What is booked aside is no cost of the fit, and what an interrupted process has spent counts once; on clocks set by hand."""

from types import SimpleNamespace

import pytest

from ia_bench.methods import monitor
from ia_bench.methods.monitor import CostTracker

CLOCKS = SimpleNamespace(wall=0.0, cpu=0.0)


@pytest.fixture(autouse=True)
def _by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = SimpleNamespace(perf_counter=lambda: CLOCKS.wall, process_time=lambda: CLOCKS.cpu)
    monkeypatch.setattr(monitor, "time", clocks)


def work(seconds: float) -> None:
    """Keep two cores busy for so many CPU seconds."""
    CLOCKS.wall, CLOCKS.cpu = CLOCKS.wall + seconds / 2, CLOCKS.cpu + seconds


def wait(seconds: float) -> None:
    CLOCKS.wall += seconds


def test_what_is_aside_is_not_counted_and_what_is_inside_belongs_to_the_outer_one() -> None:
    costs, rays = CostTracker(), {"rays": 0}
    with costs.exclude("bake"):
        costs.watch(lambda: dict(rays))
        rays["rays"] += 100
        with costs.exclude("score"):
            rays["rays"] += 10
            wait(3)
    wait(4)
    rays["rays"] += 5
    assert costs.counts() == {"rays": 5}
    assert (costs.seconds, costs.total()) == ({"bake": 3}, 7)


def test_an_interrupted_run_goes_on_where_it_was() -> None:
    first, second, rays = CostTracker(), CostTracker(), {"rays": 0}
    first.watch(lambda: {"rays": 7})
    state = {**first.state(), "total": 1000.0, "seconds": {"bake": 3.0}}
    second.watch(lambda: dict(rays))
    with second.exclude("bake"):
        rays["rays"] += 100  # baked again: in the state already
    rays["rays"] += 40  # and so is what it did before it took the state over
    second.restore(state)
    rays["rays"] += 2
    wait(1)
    assert second.counts() == {"rays": 9}
    assert (second.seconds, second.total()) == ({"bake": 3.0}, 1001)


def test_cpu_seconds_are_those_of_baking_and_fit_in_all_processes_and_idle_time_is_none() -> None:
    first, second = CostTracker(), CostTracker()
    with first.exclude("score"):
        work(50)
    with first.exclude("bake"):
        work(20)
    work(20)
    wait(50)
    assert first.cpu_seconds() == 40
    second.restore({**first.state(), "cpu_seconds": 1000.0})
    work(10)
    assert second.cpu_seconds() == 1010
