"""The loop of all methods on a line that is fitted to noisy points: resuming, the guard, the curve, seconds, bad checkpoints."""

import math
import time
from collections.abc import Callable
from typing import Any

import pytest
import torch
from small_fit import Record, Stopped, loaded, stored
from torch import Tensor, nn

from ia_bench.methods.contract import Monitor
from ia_bench.methods.descent import PATIENCE, Descent, Phase
from ia_bench.methods.monitor import CostTracker

Spoil = Callable[[int, "Line"], Tensor | None]


class Line(nn.Module):
    """a x + b."""

    def __init__(self) -> None:
        super().__init__()
        self.slope, self.offset = nn.Parameter(torch.zeros(1)), nn.Parameter(torch.zeros(2, 2))
        self.rate = math.nan  # until the second phase begins; no checkpoint has it

    def loss(self, generator: torch.Generator) -> Tensor:
        x = torch.rand(8, 1, generator=generator)
        return (self.slope * x + self.offset.mean() - 3 * x + 1).square().mean()


def fitted(record: Record, spoil: Spoil = lambda step, line: None, steps: tuple[int, int] = (30, 20)) -> tuple[Line, Descent]:
    """A fit in two phases, the slope alone and everything, whose rates fall; ``spoil``: another loss for some steps."""
    line = Line()

    def loss(step: int, generator: torch.Generator) -> Tensor:
        usual = line.loss(generator)
        changed = spoil(descent.done, line)
        return usual if changed is None else changed

    def begin(done: int) -> None:
        line.rate = 0.05
        if done == 0:  # of which nothing but the parameters outlives the process
            with torch.no_grad():
                line.offset += torch.randn(2, 2, generator=descent.generator)

    phases = [
        Phase("slope", steps[0], loss, lambda: torch.optim.Adam([line.slope], 0.1), rate=lambda share: 0.1**share),
        Phase("all", steps[1], loss, lambda: torch.optim.Adam(line.parameters(), line.rate), begin=begin),
    ]
    resume = next(reversed(record.states.values()), None)
    descent = Descent(line, phases, seed=7, monitor=record.monitor(resume))
    descent.descend(lambda: None)  # type: ignore[arg-type,return-value]
    return line, descent


def same(first: Line, second: Line) -> bool:
    return first.rate == second.rate and torch.equal(first.slope, second.slope) and torch.equal(first.offset, second.offset)


@pytest.mark.parametrize("stop", [1, 29, 30, 31, 49, 50])
def test_a_fit_that_is_stopped_saves_and_goes_on_to_the_same_bits(stop: int):
    whole, record = fitted(Record())[0], Record(stop=stop)
    with pytest.raises(Stopped):
        fitted(record)
    record.stop = -1
    resumed, descent = fitted(record)
    assert record.notes == [f"resumed at step {stop} of 50 ({'slope' if stop <= 30 else 'all'})"]
    assert same(resumed, whole)
    assert len(record.losses) == 50
    assert descent.done == descent.steps == 50


def nan_loss(step: int, line: Line) -> Tensor:
    return line.offset.sum() * math.nan


def nan_gradient(step: int, line: Line) -> Tensor:
    return torch.sqrt(line.offset * 0).sum() + line.slope.sum()  # whose value is fine


def huge_gradient(step: int, line: Line) -> Tensor:
    return (1e25 * line.slope).sum()  # Adam would keep an infinite second moment, and the slope would never move again


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (nan_loss, "the loss is NaN or Inf"),
        (nan_gradient, "the gradient of offset is NaN, Inf or too large in 4 of 4 values, the first at [0, 0]"),
        (huge_gradient, "the gradient of slope is NaN, Inf or too large in 1 of 1 values, the first at [0]"),
    ],
)
def test_a_bad_step_is_taken_back_counted_and_named(spoilt: Spoil, said: str):
    record, before = Record(), {}

    def spoil(step: int, line: Line) -> Tensor | None:
        if step in (35, 36):
            before[step] = (line.slope.clone(), line.offset.clone())
        return spoilt(step, line) if step == 35 else None

    line, descent = fitted(record, spoil)
    assert record.notes == [f"step 35 is skipped: {said}", "fit: 1 of 50 steps were skipped because of NaN or Inf"]
    assert descent.counters == {"skipped_steps": 1}
    assert [step for step, loss in enumerate(record.losses) if math.isnan(loss)] == [35]
    assert all(torch.equal(a, b) for a, b in zip(before[35], before[36], strict=True))
    assert bool(torch.isfinite(line.slope))


def test_a_parameter_that_becomes_nan_is_taken_back():
    tensor, record = torch.ones(2, 3), Record()

    def step(number: int, generator: torch.Generator) -> float:
        tensor[1, 2] = math.nan if number == 3 else number
        return 0.5

    Descent({"albedo": tensor}, [Phase("fit", 4, step=step)], seed=0, monitor=record.monitor()).descend()
    assert record.notes[0] == "step 3 is skipped: albedo became NaN or Inf in 1 of 6 values, the first at [1, 2]"
    assert tensor.tolist() == [[1, 1, 1], [1, 1, 2]]


def test_too_many_in_a_row_end_the_fit_with_the_last_good_state():
    record = Record()
    with pytest.raises(FloatingPointError, match=f"^step 21: the loss is NaN or Inf; the fit stops after {PATIENCE} such steps"):
        fitted(record, lambda step, line: nan_loss(step, line) if step >= 12 else None)
    assert len(record.notes) == PATIENCE - 1
    broken = Record(states=dict(record.states))
    with pytest.raises(FloatingPointError, match="^step 21: "):  # what is still broken stops it at once
        fitted(broken, nan_loss)
    mended, descent = fitted(Record(states=record.states))
    assert descent.counters["skipped_steps"] == PATIENCE - 1
    assert bool(torch.isfinite(mended.slope))


def test_a_short_fit_of_bad_steps_alone_has_no_result():
    phase = Phase("fit", PATIENCE - 2, step=lambda number, generator: math.nan)
    with pytest.raises(FloatingPointError, match=f"^all {PATIENCE - 2} steps were skipped because of NaN or Inf"):
        Descent({"albedo": torch.ones(2)}, [phase], seed=0, monitor=Record().monitor()).descend()


@pytest.mark.parametrize("phases", [[], [Phase("fit", 0, step=lambda number, generator: 0.0)]])
def test_a_fit_without_steps_is_refused(phases: list[Phase]):
    with pytest.raises(ValueError, match=f"^phases: expected at least one that takes steps, found none of {len(phases)}"):
        Descent({"albedo": torch.ones(2)}, phases, seed=0, monitor=Record().monitor())


def test_scores_come_at_doubling_steps_off_the_clock():
    scores = []

    def score(*given: object) -> None:
        time.sleep(0.2)
        scores.append(given)

    phases = [Phase(name, 60, step=lambda *_: 0.0, scored=name != "hidden") for name in ("a", "hidden", "b")]
    descent = Descent({}, phases, seed=0, monitor=Monitor.silent(score=score))
    started = time.perf_counter()
    descent.descend(lambda: None)  # type: ignore[arg-type,return-value]
    passed = time.perf_counter() - started
    assert [score[:2] for score in scores] == [("a", 25), ("a", 50)]
    assert sum(descent.seconds.values()) <= passed - 0.4


def test_seconds_that_are_booked_elsewhere_are_none_of_a_phase():
    """As those of baking, where a step is the first to ask for what has to be baked."""
    costs = CostTracker()

    def step(number: int, generator: torch.Generator) -> float:
        with descent.book("prior"), costs.exclude("bake"):
            time.sleep(0.1)
        return 0.0

    monitor = Monitor.silent(elsewhere=lambda: sum(costs.seconds.values()))
    descent = Descent({}, [Phase("a", 2, step=step)], seed=0, monitor=monitor)
    started = time.perf_counter()
    descent.descend()
    passed = time.perf_counter() - started
    assert costs.seconds["bake"] >= 0.2
    assert sum(descent.seconds.values()) <= passed - costs.seconds["bake"]


@pytest.mark.parametrize("damage", [lambda state: [state], lambda state: {}, lambda state: {**state, "parts": {}}])
def test_a_checkpoint_that_is_none_raises_before_a_bar_begins(damage: Callable[[Any], Any]):
    """So the run starts over, see :class:`ia_bench.methods.contract.Monitor`."""
    with pytest.raises(Stopped):
        fitted(record := Record(stop=5))
    damaged = Record(states={5: stored(damage(loaded(record.states[5])))})
    with pytest.raises((TypeError, KeyError)):
        fitted(damaged)
    assert damaged.bars == []
