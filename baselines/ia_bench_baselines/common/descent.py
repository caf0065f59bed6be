"""Gradient descent in phases, with scores off the clock and checkpoints from which a fit goes on to the same numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from ia_bench.methods.contract import Monitor, Result
from ia_bench.methods.costs import CostTracker
from ia_bench.methods.state import check_form, form_of_adam
from ia_bench.render.reconstruction import Reconstruction

FIRST_SCORE = 25  # steps; later scores follow at doubling steps


@dataclass(frozen=True)
class Phase:
    """One part of a fit: what is minimised, by which optimiser, for how many steps.

    Attributes:
        name: Under which its seconds are booked.
        steps: How many it takes.
        optimizer: Makes the optimiser of its parameters, at the phase's first step.
        loss: The loss of a step, from the step's number and the generator that draws everything random in it.
        rate: The factor of all learning rates, from the share of the phase that is done.
        begin: Called before the first step, and again where a fit goes on in this phase. What it makes must follow from the
            module's values alone, and from values that the phase itself does not train.
        project: Called after every step: back to valid values.
        scored: Whether what is recovered so far can be rendered while this phase runs.
    """

    name: str
    steps: int
    optimizer: Callable[[], torch.optim.Optimizer]
    loss: Callable[[int, torch.Generator], Tensor]
    rate: Callable[[float], float] = lambda _: 1.0
    begin: Callable[[], None] = lambda: None
    project: Callable[[], None] = lambda: None
    scored: bool = True


class Descent:
    """A fit of all tensors of a module by one phase after the other."""

    def __init__(
        self,
        module: nn.Module,
        phases: Sequence[Phase],
        *,
        seed: int,
        monitor: Monitor,
        costs: CostTracker,
        checkpoint_seconds: float,
        start: Callable[[], None] = lambda: None,
    ) -> None:
        """Ready for the first step, or for the one after the monitor's checkpoint.

        ``module``: holds everything that is trained, and every buffer that a resumed fit cannot make again. ``phases``: at least
        one of them takes steps. ``costs``: of the problem; what had been made before there was a descent should be booked
        there, as "bake". ``start``: gives the module the values that a fit starts from, booked with the first phase; a resumed
        fit does without.
        Raises ValueError where the monitor's checkpoint is none that this fit could have written.
        """
        self._module, self._monitor, self._costs, self._every = module, monitor, costs, checkpoint_seconds
        self._phases = [phase for phase in phases if phase.steps]
        device = next(module.parameters()).device
        self._generator = torch.Generator(device=device).manual_seed(seed)
        self._phase, self._step = 0, 0
        self.seconds = {phase.name: 0.0 for phase in self._phases}
        self._optimizer: torch.optim.Optimizer | None = None
        state = monitor.load()
        if state is not None:
            self._restore(state)
        else:
            with self._booked(self._phases[0]):
                start()
        self._saved = time.monotonic()

    @property
    def steps(self) -> int:
        """How many steps all phases take."""
        return sum(phase.steps for phase in self._phases)

    def run(self, recovered: Callable[[], Reconstruction]) -> Result:
        """Take the steps that are left, and give back what was found; recovering that is booked with the last phase.

        ``recovered``: what there is so far, for scores off the clock as well.
        Raises FloatingPointError where a loss is not finite; it names phase and step.
        """
        for place in range(self._phase, len(self._phases)):
            phase = self._phases[place]
            if place > self._phase:
                self._phase, self._step, self._optimizer = place, 0, None
            with self._booked(phase):
                phase.begin()
                self._optimizer = self._optimizer or phase.optimizer()
            rates = [group.setdefault("initial_lr", group["lr"]) for group in self._optimizer.param_groups]
            task = self._monitor.task(phase.name, phase.steps, self._step)
            while self._step < phase.steps:
                with self._booked(phase):
                    factor = phase.rate(self._step / phase.steps)
                    for group, rate in zip(self._optimizer.param_groups, rates, strict=True):
                        group["lr"] = rate * factor
                    loss = self._descend(phase)
                self._step += 1
                task.advance(1, loss=loss)
                self._pause(phase, recovered, last=self._step == phase.steps and place + 1 == len(self._phases))
        with self._booked(self._phases[-1]):
            found = recovered()
        return Result(found, self.seconds, steps=self.steps)

    @contextmanager
    def _booked(self, phase: Phase) -> Iterator[None]:
        """Add the seconds of a block to those of a phase."""
        started = time.perf_counter()
        yield
        self.seconds[phase.name] += time.perf_counter() - started

    def _descend(self, phase: Phase) -> float:
        assert self._optimizer is not None
        loss = phase.loss(self._step, self._generator)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise FloatingPointError(f"{phase.name}, step {self._step}: expected a finite loss, found {value}")
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._optimizer.step()
        with torch.no_grad():
            phase.project()
        return value

    def _pause(self, phase: Phase, recovered: Callable[[], Reconstruction], *, last: bool) -> None:
        """Off the clock: score at doubling steps, and keep the state from time to time."""
        ratio, rest = divmod(self._step, FIRST_SCORE)
        if phase.scored and not last and rest == 0 and ratio.bit_count() == 1:
            with self._costs.exclude("score"):
                self._monitor.score(phase.name, self._step, sum(self.seconds.values()), recovered())
        if not last and (time.monotonic() - self._saved >= self._every or self._monitor.stopping()):
            self._monitor.save(self._state())
            self._saved = time.monotonic()

    # ---- checkpoints -------------------------------------------------------------------------------------------

    def _state(self) -> dict[str, Any]:
        assert self._optimizer is not None
        return {
            "phase": self._phase,
            "step": self._step,
            "seconds": dict(self.seconds),
            "generator": self._generator.get_state(),
            "module": dict(self._module.state_dict()),
            "optimizer": self._optimizer.state_dict()["state"],
        }

    def _restore(self, state: dict[str, Any]) -> None:
        place = state.get("phase")
        if not isinstance(place, int) or not 0 <= place < len(self._phases):
            raise ValueError(f"state.phase: expected 0 to {len(self._phases) - 1}, found {place!r}")
        self._optimizer = self._phases[place].optimizer()
        check_form(state, {**self._state(), "optimizer": form_of_adam(self._optimizer)["state"]})
        steps = self._phases[place].steps
        if not 0 <= state["step"] <= steps:
            raise ValueError(f"state.step: expected 0 to {steps}, found {state['step']}")
        self._phase, self._step, self.seconds = place, state["step"], dict(state["seconds"])
        self._generator.set_state(state["generator"])
        self._module.load_state_dict(state["module"])
        self._optimizer.load_state_dict({"state": state["optimizer"], "param_groups": self._optimizer.state_dict()["param_groups"]})
        self._monitor.note(f"resumed at step {self._step} of {steps} ({self._phases[place].name})")
