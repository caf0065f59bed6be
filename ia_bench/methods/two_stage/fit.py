"""One fit of two stages, as the paper has them: samples of the prior, steps, samples guided by the renders, steps."""

from __future__ import annotations

import numpy as np
import torch

from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.descent import Descent, Phase, Stateful, check_finite, check_gradients
from ia_bench.methods.two_stage.least_squares import solved_albedo
from ia_bench.methods.two_stage.losses import Losses
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.methods.two_stage.regularise import Regularisation
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.start import start_albedo, start_light
from ia_bench.render.reconstruction import TexturedReconstruction


class Fit:
    """State of one fit; :class:`ia_bench.methods.descent.Descent` is its loop."""

    def __init__(self, problem: Problem, settings: FitSettings, seed: int, monitor: Monitor) -> None:
        self.problem, self.settings, self.monitor = problem, settings, monitor
        for view in problem.scene.train:
            check_finite(f"training view {view.name}: {{}} is NaN or Inf", {"the image": torch.from_numpy(np.asarray(view.image))})
        self.parameters = Parameters(problem, settings)
        self.prior = PriorLoss(problem, seed, monitor)
        self.losses = Losses(problem, settings, self.prior)
        self.regularisation = Regularisation(problem, settings, self.parameters, self.prior.sampler.refine)
        first, second = settings.stage1_steps, settings.stage2_steps
        self.steps = first + second
        stages = [
            Phase("stage1", first, step=self._step, after=self._regularise),
            Phase(
                "stage2",
                second,
                step=lambda step, generator: self._step(first + step, generator),
                begin=self._begin_stage2,
                after=lambda done: self._regularise(first + done),
            ),
        ]
        beside: dict[str, Stateful] = {"optimisers": self.parameters, "prior": self.prior, "regularisation": self.regularisation}
        changed = self.parameters.changed
        self.descent = Descent(changed, stages, seed=seed, monitor=monitor, start=self._start, beside=beside)

    def finish(self) -> Result:
        """Run the remaining steps and return what was recovered, unobserved texels filled from their neighbours."""
        descent, generator = self.descent, self.descent.generator
        descent.descend(lambda: self._reconstruction(final=False))
        if self.settings.solve_albedo:
            with descent.book("stage2"):
                self._solve_albedo()
        with descent.book("prior"):
            self.regularisation.between(self.steps, self.steps, generator)
        recovered = self._reconstruction(final=True)
        counters = {
            **self.prior.sampler.counters,
            **descent.counters,
            "regularisers_clamped": self.regularisation.clamped,
            "scale_ambiguity_blocked_steps": self.parameters.scale_ambiguity.blocked,
            "samples_per_pixel": self.losses.samples_per_pixel,
        }
        return Result(recovered, descent.seconds, counters, self.steps)

    # ---- the stages ----------------------------------------------------------------------------------------------------

    def _start(self) -> None:
        problem, settings, taken = self.problem, self.settings, self.losses.samples_per_pixel
        if taken != problem.plan.samples:
            self.monitor.note(f"render.samples={problem.plan.samples}: steps take {taken} a pixel, by its points")
        if problem.photographs.unit != 1:
            self.monitor.note(f"photographs: their mean radiance is unusual; compared multiplied by {problem.photographs.unit:.3g}")
        self._ask(guided=False)
        start_albedo(self.parameters, problem, settings.albedo_initial, self.prior.start)
        start_light(self.parameters, problem, self.descent.generator)

    def _begin_stage2(self, done: int) -> None:
        if not done and self.settings.guided and self.problem.prior.info.guidable:
            self._ask(guided=True)

    def _ask(self, *, guided: bool) -> None:
        """Sample the prior; samples kept from an earlier run take as long as they did then."""
        sampler = self.prior.sampler
        with self.descent.book("prior"):
            before = sampler.kept_seconds
            self.prior.draw(self.parameters if guided else None, self.descent.generator)
        self.descent.seconds["prior"] += sampler.kept_seconds - before

    def _step(self, step: int, generator: torch.Generator) -> float:
        """One step of Adam along the sum of all losses; raises FloatingPointError where something is not finite."""
        with self.descent.book("prior"):
            self.prior.update(step, self.parameters, generator)
        parameters, entries = self.parameters, self.problem.gbuffer.pixel
        pixels = torch.randint(len(entries), (self.settings.pixels,), generator=generator, device=entries.device)
        parameters.clear()
        losses, rendered = self.losses(pixels, parameters, step, self.steps, generator)
        loss = torch.stack(list(losses.values())).sum()
        check_finite("the rendered {} is NaN or Inf", {"radiance": rendered.radiance, "albedo": rendered.albedo})
        check_finite("{} is NaN or Inf", {"the loss": loss})
        loss.backward()
        check_gradients(parameters.gradients)
        parameters.descend(step, self.steps)
        check_finite("{} became NaN or Inf", {"the light's radiance": torch.exp(parameters.tensors["log_light"].detach())})
        return float(loss.detach())

    def _regularise(self, done: int) -> None:
        if done < self.steps:  # the end is after the albedo was solved for
            with self.descent.book("prior"):
                self.regularisation.between(done, self.steps, self.descent.generator)

    @torch.no_grad()
    def _solve_albedo(self) -> None:
        parameters = self.parameters
        material, light = parameters.material(detached=True), parameters.light()
        albedo = solved_albedo(self.problem, parameters.exposures, material, light, self.descent.generator)
        parameters.tensors["albedo"].copy_(albedo)

    def _reconstruction(self, *, final: bool) -> TexturedReconstruction:
        material, light = self.parameters.recovered(final=final)
        if final:
            with self.descent.book("prior"):
                material = self.regularisation.completed(material, self.descent.generator)
        return TexturedReconstruction(self.problem.stage, material, light, coat=self.problem.render.coat)
