"""The one resumable loop: steps in phases, with a guard against NaN, checkpoints, the curve, progress, and seconds by phase.

A method says what it optimises, how, for how many steps, and what there is to be scored::

    texture = torch.nn.Parameter(torch.full((256, 256, 3), 0.5))
    phase = Phase("fit", 500, loss, optimizer=lambda: torch.optim.Adam([texture], lr=0.03))
    descent = Descent({"albedo": texture}, [phase], seed=seed, monitor=monitor)
    return descent.run(lambda: TexturedReconstruction(problem.stage, Material(texture.detach(), roughness), light))

with ``loss(step, generator) -> Tensor``. A fit that is interrupted and goes on ends with the numbers of one that was not, as long
as a step depends on nothing but its number, the generator, the parameters, and what is named in ``beside``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from ia_bench.methods.monitor import Monitor, Result

if TYPE_CHECKING:
    from ia_bench.render.reconstruction import Reconstruction

FIRST_SCORE = 25  # steps; later scores follow at doubling steps
SELDOM = 50  # a state is saved at most once in so many times the seconds that it takes
PATIENCE = 10  # bad steps in a row that end a fit: one is bad luck of its samples, ten are not


class Stateful(Protocol):
    """What can be written into a checkpoint, as modules and optimisers of torch can."""

    def state_dict(self) -> Mapping[str, Any]:
        """Tensors, numbers, texts, and lists and dicts of them."""
        ...

    def load_state_dict(self, state: Any) -> Any:  # noqa: ANN401 (as torch has it)
        """Go on from a :meth:`state_dict`; raises whatever it likes for one of something else."""
        ...


@dataclass(frozen=True)
class Phase:
    """One part of a fit: a ``loss`` and an ``optimizer``, or a ``step`` that does everything by itself.

    A loss or a step may raise FloatingPointError, in words of its own, for a value that is not finite.

    Attributes:
        name: The name under which its seconds are booked.
        steps: How many it takes.
        loss: Gives the loss of a step, from the step's number in the phase and the generator that draws everything random in it.
        optimizer: Makes the optimiser, after ``begin``.
        step: Takes a step and gives its loss, from the same arguments.
        rate: Gives the factor of all learning rates, from the part of the phase that is done, 0 to 1.
        begin: Is called before the phase's first step with 0, and with the number of steps done where a fit goes on in the phase.
            What it makes for a fit that goes on must follow from what the checkpoint holds.
        project: Is called after every step without gradients, and brings the parameters back to valid values.
        after: Is called after every step with the number of steps done in the phase; its seconds are the phase's.
        scored: Whether what is recovered so far can be rendered while this phase runs.
    """

    name: str
    steps: int
    loss: Callable[[int, torch.Generator], Tensor] | None = None
    optimizer: Callable[[], Optimizer] | None = None
    step: Callable[[int, torch.Generator], float] | None = None
    rate: Callable[[float], float] | None = None
    begin: Callable[[int], None] = lambda _: None
    project: Callable[[], None] = lambda: None
    after: Callable[[int], None] = lambda _: None
    scored: bool = True


class Descent:
    """A fit by one phase after the other.

    A step in which a loss, a gradient or a parameter is NaN or Inf is taken back, counted and told; PATIENCE of them in a row end
    the fit with a FloatingPointError, after the last good state was saved, and so does a fit whose steps were all of this kind.

    Attributes:
        steps: How many all phases take.
        seconds: By phase, and by whatever else was booked.
        counters: What a reader of the results should know; "skipped_steps" are those that were taken back.
    """

    def __init__(
        self,
        parameters: nn.Module | Mapping[str, Tensor],
        phases: Sequence[Phase],
        *,
        seed: int,
        monitor: Monitor,
        start: Callable[[], None] = lambda: None,
        beside: Mapping[str, Stateful] | None = None,
    ) -> None:
        """Make the loop; nothing runs yet.

        Args:
            parameters: What the phases change: a module with its buffers, or tensors by name.
            phases: At least one of them takes steps; ValueError where none does.
            seed: Seed of the generator that steps draw from.
            monitor: Where progress, scores and checkpoints go.
            start: Gives the parameters the values that a fit starts from, booked with the first phase. A fit that goes on from a
                checkpoint does without.
            beside: What else a checkpoint must hold, by name.
        """
        self._phases, self._monitor, self._start = [phase for phase in phases if phase.steps], monitor, start
        if not self._phases:
            raise ValueError(f"phases: expected at least one that takes steps, found none of {len(phases)}")
        self._parts: dict[str, Stateful] = dict(beside or {})
        if isinstance(parameters, nn.Module):
            self._parameters: dict[str, Tensor] = dict(parameters.named_parameters())
            self._parts["parameters"] = parameters
        else:
            self._parameters = dict(parameters)
            same = {name: nn.Parameter(one.detach(), requires_grad=False) for name, one in parameters.items()}
            self._parts["parameters"] = nn.ParameterDict(same)  # over the same memory
        device = next((parameter.device for parameter in self._parameters.values()), torch.device("cpu"))
        self.generator = torch.Generator(device=device).manual_seed(seed)
        self.steps = sum(phase.steps for phase in phases)
        self.seconds = {phase.name: 0.0 for phase in phases}
        self.counters = {"skipped_steps": 0}
        self._in_a_row = 0  # steps that were taken back since the last good one
        self._place = self._step = 0  # the phase, and the steps that are done in it
        self._optimizer: Optimizer | None = None
        self._kept: dict[str, Tensor] = {}
        self._saving = 0.0  # seconds that the last state took
        self._inner = 0.0  # seconds that blocks inside the current one have booked

    @property
    def done(self) -> int:
        """How many steps have been taken."""
        return sum(phase.steps for phase in self._phases[: self._place]) + self._step

    def run(self, recovered: Callable[[], Reconstruction]) -> Result:
        """Take the steps that are left and give back what was found: what is ``recovered``, which is also scored on the way."""
        self.descend(recovered)
        with self.book(self._phases[-1].name):
            found = recovered()
        return Result(found, dict(self.seconds), dict(self.counters), self.steps)

    def descend(self, recovered: Callable[[], Reconstruction] | None = None) -> None:
        """Take the steps that are left, from the start or from the monitor's checkpoint.

        Raises whatever the parts of a checkpoint raise that is none of this fit, before it begins a bar of progress.
        """
        state = self._monitor.load()
        if state is None:
            with self.book(self._phases[0].name):
                self._start()
        else:
            self._load(state)
            self._monitor.note(f"resumed at step {self.done} of {self.steps} ({self._phases[self._place].name})")
        self._saved = time.monotonic()
        for place in range(self._place, len(self._phases)):
            if state is None or place > self._place:
                self._place, self._step = place, 0
                self._enter(self._phases[place])
            self._run_phase(self._phases[place], recovered)
        self.check_progress()
        if self.counters["skipped_steps"]:
            self._monitor.note(f"fit: {self.counters['skipped_steps']} of {self.steps} steps were skipped because of NaN or Inf")

    def check_progress(self) -> None:
        """Raise FloatingPointError where every step so far was taken back: there is no result."""
        if self.counters["skipped_steps"] == self.done > 0:
            raise FloatingPointError(f"all {self.done} steps were skipped because of NaN or Inf; nothing has been fitted")

    @contextmanager
    def book(self, name: str) -> Iterator[None]:
        """Book the seconds of a block under ``name``, but those booked elsewhere; they are taken out of the block around it."""
        outside, self._inner = self._inner, 0.0
        started, elsewhere = time.perf_counter(), self._monitor.elsewhere()
        try:
            yield
        finally:
            passed = time.perf_counter() - started - (self._monitor.elsewhere() - elsewhere)
            self.seconds[name] = self.seconds.get(name, 0.0) + passed - self._inner
            self._inner = outside + passed

    # ---- steps -------------------------------------------------------------------------------------------------

    def _enter(self, phase: Phase) -> None:
        with self.book(phase.name):
            phase.begin(self._step)
            self._optimizer = None if phase.optimizer is None else phase.optimizer()

    def _run_phase(self, phase: Phase, recovered: Callable[[], Reconstruction] | None) -> None:
        if self._step == phase.steps:
            return
        bar = self._monitor.task(phase.name, phase.steps, self._step)
        while self._step < phase.steps:
            with self.book(phase.name):
                loss = self._guarded(phase)
                self._step += 1
                phase.after(self._step)
            bar.advance(1, loss=loss)
            self._pause(phase, recovered)

    def _guarded(self, phase: Phase) -> float:
        """The loss of a step; NaN of one that was taken back."""
        with torch.no_grad():
            for name, parameter in self._parameters.items():
                self._kept.setdefault(name, torch.empty_like(parameter)).copy_(parameter)
        try:
            loss = self._optimise(phase)
            if not math.isfinite(loss):
                raise FloatingPointError(f"the loss is {loss}")
            check_finite("{} became NaN or Inf", self._parameters)
        except FloatingPointError as error:
            with torch.no_grad():  # the optimiser's moments stay: only finite gradients, with finite squares, ever reach them
                for name, parameter in self._parameters.items():
                    parameter.copy_(self._kept[name])
            if self._in_a_row + 1 == PATIENCE:
                self._save()
                raise FloatingPointError(
                    f"step {self.done}: {error}; the fit stops after {PATIENCE} such steps in a row and keeps the last good state"
                ) from error
            self.counters["skipped_steps"] += 1
            self._in_a_row += 1
            self._monitor.note(f"step {self.done} is skipped: {error}")
            return math.nan
        self._in_a_row = 0
        return loss

    def _optimise(self, phase: Phase) -> float:
        if phase.step is not None:
            loss = phase.step(self._step, self.generator)
        else:
            assert phase.loss is not None, "a phase has a step, or a loss and an optimiser"
            assert self._optimizer is not None, "a phase has a step, or a loss and an optimiser"
            if phase.rate is not None:
                factor = phase.rate(self._step / phase.steps)
                for group in self._optimizer.param_groups:
                    group["lr"] = factor * group.setdefault("initial_lr", group["lr"])
            self._optimizer.zero_grad()
            for parameter in self._parameters.values():  # those of other phases as well
                parameter.grad = None
            value = phase.loss(self._step, self.generator)
            check_finite("{} is NaN or Inf", {"the loss": value.detach()})
            value.backward()
            check_gradients({name: parameter.grad for name, parameter in self._parameters.items()})
            self._optimizer.step()
            loss = float(value.detach())
        with torch.no_grad():
            phase.project()
        return loss

    def _pause(self, phase: Phase, recovered: Callable[[], Reconstruction] | None) -> None:
        """Off the clock: score at doubling steps, and keep the state from time to time."""
        done, last = self.done, self.done == self.steps
        ratio, rest = divmod(done, FIRST_SCORE)
        if recovered is not None and phase.scored and not last and rest == 0 and ratio.bit_count() == 1:
            self._monitor.score(phase.name, done, sum(self.seconds.values()), recovered)
        stopping = self._monitor.stopping()
        seconds = self._monitor.checkpoint_seconds
        wait = max(seconds, SELDOM * self._saving) if seconds else 0.0
        if stopping or (not last and time.monotonic() - self._saved >= wait):
            self._save()

    # ---- checkpoints -------------------------------------------------------------------------------------------

    def _save(self) -> None:
        started = time.monotonic()
        self._monitor.save({
            "phase": self._place,
            "step": self._step,
            "seconds": dict(self.seconds),
            "counters": dict(self.counters),
            "in_a_row": self._in_a_row,
            "generator": self.generator.get_state(),
            "optimizer": None if self._optimizer is None else self._optimizer.state_dict(),
            "parts": {name: part.state_dict() for name, part in self._parts.items()},
        })  # fmt: skip
        self._saved = time.monotonic()
        self._saving = self._saved - started

    def _load(self, state: Mapping[str, Any]) -> None:
        phase = self._phases[state["phase"]]
        self._place, self._step, self.seconds = state["phase"], state["step"], dict(state["seconds"])
        self.counters, self._in_a_row = dict(state["counters"]), state["in_a_row"]
        self.generator.set_state(state["generator"])
        for name, part in self._parts.items():
            part.load_state_dict(state["parts"][name])
        self._enter(phase)  # also where all its steps are done: what begin() makes is in no checkpoint
        if self._optimizer is not None:
            self._optimizer.load_state_dict(state["optimizer"])


def check_gradients(gradients: Mapping[str, Tensor | None]) -> None:
    """Raise FloatingPointError where the square of a gradient is not finite: Adam would keep it as a moment."""
    squares = {name: gradient.square() for name, gradient in gradients.items() if gradient is not None}
    check_finite("the gradient of {} is NaN, Inf or too large", squares)


@torch.no_grad()
def check_finite(what: str, values: Mapping[str, Tensor]) -> None:
    """Raise FloatingPointError where a tensor is not finite; ``what`` says so, with ``{}`` for the tensor's name."""
    if not values or bool(torch.isfinite(torch.stack([value.sum() for value in values.values()]).sum())):
        return  # sums alone: looking at every value takes ten times as long
    for name, value in values.items():
        bad = torch.nonzero(~torch.isfinite(value))
        if len(bad):
            place = f" in {len(bad)} of {value.numel()} values, the first at {bad[0].tolist()}" if value.ndim else ""
            raise FloatingPointError(what.format(name) + place)
