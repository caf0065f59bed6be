"""What is booked aside is no cost of the fit, and what an interrupted process has spent counts once."""

import time

from ia_bench.methods.monitor import CostTracker


def test_what_is_aside_is_not_counted_and_what_is_inside_belongs_to_the_outer_one() -> None:
    costs, rays = CostTracker(), {"rays": 0}
    with costs.exclude("bake"):
        costs.watch(lambda: dict(rays))
        rays["rays"] += 100
        with costs.exclude("score"):
            rays["rays"] += 10
            time.sleep(0.01)
    rays["rays"] += 5
    assert costs.counts() == {"rays": 5}
    assert list(costs.seconds) == ["bake"]
    assert 0.01 <= costs.seconds["bake"] <= costs.total()


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
    assert second.counts() == {"rays": 9}
    assert second.seconds == {"bake": 3.0}
    assert second.total() > 1000


def work(seconds: float) -> None:
    """Keep one core busy for so many CPU seconds."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_cpu_seconds_are_those_of_baking_and_fit_in_all_processes_and_idle_time_is_none() -> None:
    first, second = CostTracker(), CostTracker()
    with first.exclude("score"):
        work(0.05)
    with first.exclude("bake"):
        work(0.02)
    work(0.02)
    time.sleep(0.05)
    assert 0.04 <= first.cpu_seconds() < 0.06
    second.restore({**first.state(), "cpu_seconds": 1000.0})
    work(0.01)
    assert 1000.01 <= second.cpu_seconds() < 1000.05
