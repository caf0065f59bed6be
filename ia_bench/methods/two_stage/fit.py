"""One fit of two stages, as the paper has them: samples of the prior, steps, samples guided by the renders, steps."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.common.machine import return_memory
from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.contract import FitState, Monitor, PixelSamples, Problem, Regulariser, Result
from ia_bench.methods.descent import Descent, Phase, Stateful, check_finite, check_gradients
from ia_bench.methods.photographs import light_of_the_mean_image
from ia_bench.methods.regularisers.choice import regularisers_of
from ia_bench.methods.two_stage.least_squares import solved_albedo
from ia_bench.methods.two_stage.losses import Losses
from ia_bench.methods.two_stage.parameters import LEAST, Parameters
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.reconstruction import TexturedReconstruction

ROUNDING = 1e-6
"""A value so little out of its range is one that was rounded."""


class TwoStageFit:
    """State of one fit; :class:`ia_bench.methods.descent.Descent` is its loop."""

    def __init__(self, problem: Problem, settings: FitSettings, seed: int, monitor: Monitor) -> None:
        """Raises InputError for a regulariser that cannot be applied."""
        self.problem, self.settings, self.monitor = problem, settings, monitor
        self.parameters = Parameters(problem, settings)
        self.prior = PriorLoss(problem, seed, monitor)
        self.losses = Losses(problem, settings, self.prior)
        self.regularisers = regularisers_of(settings.regularise, settings.regulariser_options)
        for regulariser in self.regularisers:
            regulariser.prepare(problem)
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
        beside: dict[str, Stateful] = {**self.parameters.optimisers, "prior": self.prior}
        tensors = self.parameters.tensors
        self.descent = Descent(tensors, stages, seed=seed, monitor=monitor, start=self._start, beside=beside)
        self.descent.counters |= {"regularisers_clamped": 0, "scale_ambiguity_blocked_steps": 0}
        return_memory()  # what preparing took

    def finish(self) -> Result:
        """Run the remaining steps and return what was recovered, unobserved texels filled from their neighbours.

        The albedo is solved for after the last regulariser, so that the photographs have the last word on it.
        """
        descent = self.descent
        descent.descend(lambda: self._reconstruction(final=False))
        solve, parameters = self.settings.solve_albedo, self.parameters
        if solve is True or (solve == "auto" and not self.prior.says_albedo):
            with descent.book("stage2"), torch.no_grad():
                material, light = parameters.material(detached=True), parameters.light()
                albedo = solved_albedo(self.problem, parameters.exposures, material, light, descent.generator)
                descent.counters["solved_albedo_clamped"] = 0
                parameters.tensors["albedo"].copy_(self._in_range("albedo", albedo, "solved_albedo_clamped"))
        with descent.book("stage2"):
            recovered = self._reconstruction(final=True)
        samples = {"samples_per_pixel": self.losses.samples_per_pixel}
        return Result(recovered, descent.seconds, {**self.prior.sampler.counters, **descent.counters, **samples}, self.steps)

    # ---- the stages ----------------------------------------------------------------------------------------------------

    def _start(self) -> None:
        problem, settings, taken = self.problem, self.settings, self.losses.samples_per_pixel
        if taken != problem.plan.samples:
            self.monitor.note(f"render.samples={problem.plan.samples}: steps take {taken} a pixel, by its points")
        if problem.photographs.unit != 1:
            self.monitor.note(f"photographs: their mean radiance is unusual; compared multiplied by {problem.photographs.unit:.3g}")
        self._ask(guided=False)
        with torch.no_grad():
            self.parameters.tensors["albedo"].copy_(initial_albedo(problem, settings.albedo_initial, self.prior.start))
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
        self.descent.counters["scale_ambiguity_blocked_steps"] += parameters.descend(step, self.steps)
        check_finite("{} became NaN or Inf", {"the light's radiance": torch.exp(parameters.tensors["log_light"].detach())})
        return float(loss.detach())

    # ---- the regularisers of ``fit.regularise``, one after the other ----------------------------------------------------

    @torch.no_grad()
    def _regularise(self, done: int) -> None:
        """Change the textures after ``done`` steps where that is due, once the albedo is optimised at all."""
        due = [one for one in self.regularisers if not one.completes and one.due(done, self.steps)]
        if due and "albedo" not in self.parameters.frozen(done, self.steps):
            material = self._applied(due, self.parameters.material(detached=True))
            for name in ("albedo", "roughness"):
                self.parameters.tensors[name].copy_(getattr(material, name))

    @torch.no_grad()
    def _applied(self, regularisers: list[Regulariser], material: Material) -> Material:
        """What they make of the ``material``; values that are out of range by more than ROUNDING are counted."""
        found, generator, refine = self.parameters, self.descent.generator, self.prior.sampler.refine
        state = FitState(self.problem, found.light(), found.exposures, found.observed, generator, refine)
        with self.descent.book("prior"):
            for regulariser in regularisers:
                moved = regulariser.apply(material, state)
                albedo, roughness = (
                    self._in_range(name, getattr(moved, name), "regularisers_clamped") for name in ("albedo", "roughness")
                )
                material = Material(albedo, roughness, material.metallic)
        return material

    def _in_range(self, name: str, texture: Tensor, counter: str) -> Tensor:
        """The texture in its range; the ``counter`` tells how many values were out of it by more than ROUNDING."""
        allowed = texture.clamp(LEAST[name], 1)
        self.descent.counters[counter] += int(((texture - allowed).abs() > ROUNDING).sum())
        return allowed

    def _reconstruction(self, *, final: bool) -> TexturedReconstruction:
        material, light = self.parameters.recovered(final=final)
        if final:  # what photographs hardly show is guessed once unseen texels are filled
            material = self._applied([one for one in self.regularisers if one.completes], material)
        problem = self.problem
        return TexturedReconstruction(problem.stage, material, light, coat=problem.render.coat, turning=problem.scene.turning)


# ---- where it starts: an albedo that the prior or the images suggest, an even light that explains the images' mean ----


@torch.no_grad()
def initial_albedo(problem: Problem, mean: float, targets: PixelSamples | None) -> Tensor:
    """The albedo (T, T, 3) that a fit starts from: the ``targets`` averaged over the views in texture space.

    Without any (None where they do not say which albedo a pixel has) it has the images' mean colour, of that ``mean``.
    """
    size, colour = problem.plan.texture, problem.photographs.mean_radiance
    colour = mean * colour / colour.mean().clamp_min(1e-30)
    if targets is None or not bool(targets.weight.any()):  # none, or of views that do not show the mesh
        return (colour / colour.max().clamp_min(1.0)).clamp(0, 1).expand(size, size, 3)
    gbuffer = problem.gbuffer
    hit = (gbuffer.face >= 0) & (targets.weight > 0)
    uv = problem.renderer.surface.uv(gbuffer.face[hit].long(), gbuffer.barycentric[hit])
    covered = (hit.float().mean(1, keepdim=True)).clamp_min(1e-6)
    values = (targets.values["albedo"] / covered)[:, None].expand(-1, gbuffer.subsamples, -1)[hit]
    average, weight = splat(uv, values, size)
    return fill_unobserved(average, weight > 0).clamp(0, 1)


@torch.no_grad()
def start_light(parameters: Parameters, problem: Problem, generator: torch.Generator) -> None:
    """Set the light to the even one that gives the albedo at the start the images' mean colour.

    Of all pixels that no mask leaves out, clipped ones among them: a start that is off is left behind, and those that are known
    alone would be too dark.
    """
    log_light, material = parameters.tensors["log_light"], parameters.material()
    radiance, rendered = light_of_the_mean_image(problem, ~problem.photographs.left_out, material, len(log_light), generator)
    check_finite("the rendered {} is NaN or Inf", {"radiance of the start": rendered})
    log_light += torch.log(radiance)
