"""One fit of two stages: its steps in order, its curve, its checkpoints."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import torch

from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.two_stage.guard import PATIENCE, StepGuard
from ia_bench.methods.two_stage.least_squares import solved_albedo
from ia_bench.methods.two_stage.losses import Losses
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.methods.two_stage.regularise import Regularisation
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.start import start_albedo, start_light
from ia_bench.render.reconstruction import TexturedReconstruction

FIRST_SCORE = 25  # steps; later scores follow at doubling steps


class Fit:
    """State of one fit."""

    def __init__(self, problem: Problem, settings: FitSettings, seed: int, monitor: Monitor) -> None:
        self.problem, self.settings, self.monitor = problem, settings, monitor
        _check_images(problem)
        self.steps = settings.stage1_steps + settings.stage2_steps
        self.step = 0
        self.seconds = {"stage1": 0.0, "stage2": 0.0}
        self.generator = torch.Generator(device=problem.device).manual_seed(seed)
        self.parameters = Parameters(problem, settings)
        exposures = self.parameters.exposures
        self.guard = StepGuard(problem, self.parameters.tensors, {} if exposures is None else {"exposures": exposures.log})
        self.prior = PriorLoss(problem, seed, monitor)
        self.losses = Losses(problem, settings, self.prior)
        self.regularisation = Regularisation(problem, settings, self.parameters, self.prior.sampler.refine)
        state = monitor.load()
        if state is not None:
            self._restore(state)
        else:
            taken = self.losses.samples_per_pixel
            if taken != problem.plan.samples:
                monitor.note(f"render.samples={problem.plan.samples}: steps take {taken} a pixel, by its points")
            if problem.photographs.unit != 1:
                monitor.note(f"photographs: their mean radiance is unusual; compared multiplied by {problem.photographs.unit:.3g}")
            self.prior.draw(None, self.generator)
            started = time.perf_counter()
            start_albedo(self.parameters, problem, settings.albedo_initial, self.prior.start)
            start_light(self.parameters, problem, self.guard, self.generator)
            self.seconds["stage1"] += time.perf_counter() - started
        self.saved = time.monotonic()

    def finish(self) -> Result:
        """Run the remaining steps and return what was recovered, unobserved texels filled from their neighbours."""
        boundary = self.settings.stage1_steps
        for stage, end in (("stage1", boundary), ("stage2", self.steps)):
            if self.step >= end:
                continue
            if stage == "stage2" and self.step == boundary and self.settings.guided and self.prior.guidable:
                self.prior.draw(self.parameters, self.generator)
            first = 0 if stage == "stage1" else boundary
            task = self.monitor.task(stage.replace("stage", "stage "), end - first, self.step - first)
            while self.step < end:
                self.prior.update(self.step, self.parameters, self.generator)
                started = time.perf_counter()
                loss = self._step()
                self.step += 1
                self.seconds[stage] += time.perf_counter() - started
                if self.step < self.steps:  # before a state is saved, so that one that is resumed does not correct it again
                    self.regularisation.between(self.step, self.steps, self.generator)
                task.advance(1, loss=loss)
                self._pause(stage)
        if self.settings.solve_albedo:
            self._solve_albedo()
        self.regularisation.between(self.step, self.steps, self.generator)
        if self.guard.skipped:
            self.monitor.note(f"fit: {self.guard.skipped} of {self.steps} steps were skipped because of NaN or Inf")
        recovered = self._recovered(final=True)
        counters = {
            **self.prior.sampler.counters,
            "regularisers_clamped": self.regularisation.clamped,
            "skipped_steps": self.guard.skipped,
            "scale_ambiguity_blocked_steps": self.parameters.scale_ambiguity.blocked,
            "samples_per_pixel": self.losses.samples_per_pixel,
        }
        return Result(recovered, {"prior": self._prior_seconds, **self.seconds}, counters, self.steps)

    # ---- one step ----------------------------------------------------------------------------------------------

    def _step(self) -> float:
        """The loss of a step; NaN of one that was skipped, which leaves the parameters as they were."""
        guard = self.guard
        guard.keep()
        try:
            loss = self._optimise()
        except FloatingPointError as error:
            guard.back_off()
            if guard.in_a_row + 1 == PATIENCE:
                self._save()
                raise FloatingPointError(
                    f"step {self.step}: {error}; the fit stops after {PATIENCE} such steps in a row and keeps the last good state"
                ) from error
            guard.skipped, guard.in_a_row = guard.skipped + 1, guard.in_a_row + 1
            self.monitor.note(f"step {self.step} is skipped: {error}")
            return math.nan
        guard.in_a_row = 0
        return loss

    def _optimise(self) -> float:
        parameters, entries = self.parameters, self.problem.gbuffer.pixel
        pixels = torch.randint(len(entries), (self.settings.pixels,), generator=self.generator, device=entries.device)
        parameters.clear()
        losses, rendered = self.losses(pixels, parameters, self.step, self.steps, self.generator)
        loss = torch.stack(list(losses.values())).sum()
        causes = {"the rendered radiance": rendered.radiance, "the rendered albedo": rendered.albedo}
        self.guard.check_loss(loss.detach(), pixels, causes)
        loss.backward()
        self.guard.check_gradients(parameters.gradients, pixels)
        parameters.descend(self.step, self.steps)
        self.guard.check_parameters()
        return float(loss.detach())

    @torch.no_grad()
    def _solve_albedo(self) -> None:
        started, parameters = time.perf_counter(), self.parameters
        material, light = parameters.material(detached=True), parameters.light()
        albedo = solved_albedo(self.problem, parameters.exposures, material, light, self.generator)
        parameters.tensors["albedo"].copy_(albedo)
        self.seconds["stage2"] += time.perf_counter() - started

    @property
    def _prior_seconds(self) -> float:
        """What the prior and the regularisers have taken."""
        return self.prior.seconds + self.regularisation.seconds

    # ---- scoring and checkpoints -------------------------------------------------------------------------------

    def _pause(self, stage: str) -> None:
        """Off the clock: score at doubling steps, and keep the state from time to time."""
        ratio = self.step / FIRST_SCORE
        if self.step < self.steps and ratio >= 1 and math.log2(ratio).is_integer():
            seconds = self._prior_seconds + sum(self.seconds.values())
            self.monitor.score(stage, self.step, seconds, lambda: self._recovered(final=False))
        due = time.monotonic() - self.saved >= self.settings.checkpoint_seconds and self.step < self.steps
        if due or self.monitor.stopping():
            self._save()
            self.saved = time.monotonic()

    def _recovered(self, *, final: bool) -> TexturedReconstruction:
        material, light = self.parameters.recovered(final=final)
        if final:
            material = self.regularisation.completed(material, self.generator)
        return TexturedReconstruction(self.problem.stage, material, light, coat=self.problem.render.coat)

    def _save(self) -> None:
        self.monitor.save(self._state())

    def _state(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "seconds": {"prior": self._prior_seconds, **self.seconds},
            "generator": self.generator.get_state(),
            "parameters": self.parameters.state(),
            "prior": self.prior.state(),
            "clamped": self.regularisation.clamped,
            "skipped": {"in_all": self.guard.skipped, "in_a_row": self.guard.in_a_row},
        }

    def _restore(self, state: dict[str, Any]) -> None:
        self.step = state["step"]
        self.seconds = {name: seconds for name, seconds in state["seconds"].items() if name != "prior"}
        self.generator.set_state(state["generator"])
        self.parameters.restore(state["parameters"])
        self.prior.restore(state["prior"], state["seconds"]["prior"])
        self.regularisation.clamped = state["clamped"]
        self.guard.skipped, self.guard.in_a_row = state["skipped"]["in_all"], state["skipped"]["in_a_row"]
        self.monitor.note(f"resumed at step {self.step} of {self.steps}")


def _check_images(problem: Problem) -> None:
    for view in problem.scene.train:
        bad = int((~np.isfinite(view.image)).sum())
        if bad:
            raise FloatingPointError(f"training view {view.name}: NaN or Inf in {bad} values of the image")
