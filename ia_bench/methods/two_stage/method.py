"""The paper's section 3.4: stage 1 with samples of the prior, stage 2 with samples guided by the current renders."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material, fetch, fill_unobserved, splat
from ia_bench.methods.asking.sampling import Images, PriorSampler
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Fit, Monitor, Problem
from ia_bench.methods.two_stage.cast import CastStep
from ia_bench.methods.two_stage.guard import PATIENCE, StepGuard
from ia_bench.methods.two_stage.losses import crossed_loss, smoothness, tone_map, total_variation
from ia_bench.methods.two_stage.neighbours import find_neighbours
from ia_bench.methods.two_stage.settings import FitSettings, check_fit, check_supervision
from ia_bench.methods.two_stage.supervision import Supervision
from ia_bench.methods.two_stage.targets import Targets, make_targets
from ia_bench.priors.contract import Prior
from ia_bench.render.renderer import PixelRadiance, samples_taken, texture_images

GUIDE_SAMPLES = 32  # per pixel, for the renders that guide stage 2 or are distilled
FIRST_SCORE = 25  # steps; later scores follow at doubling steps


class TwoStage:
    """Adam on albedo, roughness, the log radiance of the light, and a cast that light and paint exchange; see equation 5."""

    def fit(self, problem: Problem, prior: Prior, settings: FitSettings, *, seed: int, monitor: Monitor) -> Fit:
        """See :class:`ia_bench.methods.contract.Method`. Resumes from the monitor's last checkpoint, to the same numbers.

        A step in which the loss, a gradient or a parameter is NaN or Inf is skipped, said and counted (``skipped_steps``).
        Raises FloatingPointError, naming step, tensor and views, when that happens PATIENCE times in a row; the last good
        state is then in the monitor's checkpoint.
        """
        return _Run(problem, prior, settings, seed, monitor).finish()


class _Run:
    """State of one fit."""

    def __init__(self, problem: Problem, prior: Prior, settings: FitSettings, seed: int, monitor: Monitor) -> None:
        check_fit(settings)
        check_supervision(problem.supervision)
        self.problem, self.prior, self.settings, self.seed, self.monitor = problem, prior, settings, seed, monitor
        device = problem.gbuffer.face.device
        self.images = problem.pixels_of(torch.stack([torch.from_numpy(v.image) for v in problem.scene.train]).to(device))
        _check_images(problem)
        hit = problem.gbuffer.face >= 0
        seen = problem.renderer.surface.uv(problem.gbuffer.face[hit].long(), problem.gbuffer.barycentric[hit])
        self._observed = splat(seen, torch.zeros(len(seen), 0, device=device), problem.plan.texture)[1]
        self.neighbours = find_neighbours(problem, self.images, settings.smooth_scale)
        plan, t = problem.plan, problem.plan.texture
        self.parameters = {
            "albedo": torch.full((t, t, 3), settings.albedo_initial, device=device),
            "roughness": torch.full((t, t, 1), settings.roughness_initial, device=device),
            "log_light": torch.zeros(plan.light_height, 2 * plan.light_height, 3, device=device),
        }
        if plan.metallic:
            self.parameters["metallic"] = torch.full((t, t, 1), settings.metallic_initial, device=device)
        self.steps = settings.stage1_steps + settings.stage2_steps
        self.step = 0
        self.seconds = {"prior": 0.0, "stage1": 0.0, "stage2": 0.0}
        self.generator = torch.Generator(device=device).manual_seed(seed)
        for parameter in self.parameters.values():
            parameter.requires_grad_(True)
        self.base_rates = [getattr(settings.rates, name.removeprefix("log_")) for name in self.parameters]
        groups = [{"params": [p], "lr": rate} for p, rate in zip(self.parameters.values(), self.base_rates, strict=True)]
        self.optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), fused=True)
        self.cast = CastStep(self.parameters["albedo"], self.parameters["log_light"], self._observed > 0)
        self.sampler = PriorSampler(problem, prior, seed, monitor.note)
        self.guard = StepGuard(problem, self.parameters)
        state = monitor.load()
        if state is None:
            if self._samples_per_pixel != plan.samples:
                monitor.note(f"render.samples={plan.samples}: steps take {self._samples_per_pixel} a pixel, by its points")
            self._draw(guided=False)
            self._initial_albedo()
            self._initial_light()
        else:
            self._restore(state)
        self.saved = time.monotonic()

    def finish(self) -> Fit:
        """Run the remaining steps and return the fit, unobserved texels filled from their neighbours."""
        boundary = self.settings.stage1_steps
        for stage, end in (("stage1", boundary), ("stage2", self.steps)):
            if self.step >= end:
                continue
            if stage == "stage2" and self.step == boundary and self._draws_again():
                self._draw(guided=True)
            first = 0 if stage == "stage1" else boundary
            task = self.monitor.task(stage.replace("stage", "stage "), end - first, self.step - first)
            while self.step < end:
                self._distill()
                started = time.perf_counter()
                loss = self._step()
                self.step += 1
                self.seconds[stage] += time.perf_counter() - started
                task.advance(1, loss=loss)
                self._pause(stage)
        if self.guard.skipped:
            self.monitor.note(f"fit: {self.guard.skipped} of {self.steps} steps were skipped because of NaN or Inf")
        return self._snapshot(final=True)

    @property
    def _samples_a_half(self) -> int:
        """Samples of a pixel in each half of the crossed loss, before the renderer rounds them."""
        return max(1, self.problem.plan.samples // 2)

    @property
    def _samples_per_pixel(self) -> int:
        """Samples of a pixel in a step, as they are taken."""
        points = self.problem.gbuffer.subsamples
        if self.settings.image_loss == "l1":
            return samples_taken(self.problem.plan.samples, points)
        return 2 * samples_taken(self._samples_a_half, points)

    def _draws_again(self) -> bool:
        """Whether stage 2 has guided samples."""
        wanted = self.settings.guided and self.problem.supervision.kind != "sds"
        return wanted and self.prior.info.guidable and bool(self._supervising)

    @property
    def _supervising(self) -> frozenset[str]:
        """The components of the prior that have a weight; one without guides nothing, and costs no renders."""
        weights = {
            "albedo": self.settings.weights.albedo,
            "specular": self.settings.weights.specular * self.problem.supervision.specular_weight,
        }
        return frozenset(name for name in self.prior.info.provides if weights[name])

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
                self.monitor.save(self._state())
                raise FloatingPointError(
                    f"step {self.step}: {error}; the fit stops after {PATIENCE} such steps in a row and keeps the last good state"
                ) from error
            guard.skipped, guard.in_a_row = guard.skipped + 1, guard.in_a_row + 1
            self.monitor.note(f"step {self.step} is skipped: {error}")
            return math.nan
        guard.in_a_row = 0
        return loss

    def _optimise(self) -> float:
        settings, weights = self.settings, self.settings.weights
        gbuffer = self.problem.gbuffer
        progress = self.step / max(self.steps - 1, 1)
        for group, rate in zip(self.optimizer.param_groups, self.base_rates, strict=True):
            group["lr"] = rate * settings.rates.final**progress
        starts = {"albedo": settings.albedo_start, "log_light": 0.0}
        frozen = [name for name in self.parameters if self.step < starts.get(name, settings.roughness_start) * self.steps]
        pixels = torch.randint(
            len(gbuffer.pixel), (settings.pixels,), generator=self.generator, device=gbuffer.pixel.device
        )
        self.supervision.update(self.parameters["albedo"], self.step)
        material = self._material()
        light = SampledLight.of(torch.exp(self.parameters["log_light"]), uniform_fraction=settings.light_uniform)
        target = self.images[pixels]
        if settings.image_loss == "l1":
            rendered = self._render(pixels, material, light, self.problem.plan.samples)
            loss = weights.image * (tone_map(rendered.radiance) - tone_map(target)).abs().mean()
        else:
            halves = self._render(pixels.repeat(2), material, light, self._samples_a_half)
            rendered = halves.averaged(2)
            first, second = halves.radiance.chunk(2)
            loss = weights.image * crossed_loss(first, second, target, settings.residual_cut)
        causes = {"the rendered radiance": rendered.radiance, "the rendered albedo": rendered.albedo}
        if "albedo" in self.supervision.targets.values:
            supervised = self.supervision.albedo_loss(rendered.albedo, pixels, material.albedo, self.generator)
            loss = loss + weights.albedo * supervised
        if "specular" in self.supervision.targets.values:
            loss = loss + weights.specular * self.supervision.specular_loss(rendered.specular, pixels)
        loss = loss + self._smoothness(pixels, frozen)
        if weights.smooth_light:
            loss = loss + weights.smooth_light * total_variation(self.parameters["log_light"])
        self.guard.check_loss(loss.detach(), pixels, causes)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.guard.check_gradients(pixels)
        if settings.rates.cast and "albedo" not in frozen and self.step >= settings.cast_start * self.steps:
            self.cast(settings.rates.cast * settings.rates.final**progress)
        for name in frozen:  # the gradient is computed all the same, so that one compiled step serves the whole run
            self.parameters[name].grad = None
        self.optimizer.step()
        with torch.no_grad():  # projected onto the valid range, so that no clamp in the model can kill a gradient
            self.parameters["albedo"].clamp_(0, 1)
            self.parameters["roughness"].clamp_(MIN_ROUGHNESS, 1)
            if "metallic" in self.parameters:
                self.parameters["metallic"].clamp_(0, 1)
        self.guard.check_parameters()
        return float(loss.detach())

    def _material(self, *, detached: bool = False) -> Material:
        textures = (self.parameters.get(name) for name in ("albedo", "roughness", "metallic"))
        return Material(*(t.detach() if detached and t is not None else t for t in textures))  # type: ignore[arg-type]

    def _render(self, pixels: Tensor, material: Material, light: SampledLight, samples: int) -> PixelRadiance:
        return self.problem.renderer.render_pixels(self.problem.gbuffer, pixels, material, light, samples, self.generator)

    def _smoothness(self, pixels: Tensor, frozen: list[str]) -> Tensor:
        weights, neighbours = self.settings.weights, self.neighbours
        other = neighbours.index[pixels].reshape(-1)
        uv = neighbours.uv[pixels].repeat_interleave(2, 0)
        similarity = neighbours.similarity[pixels].reshape(-1)
        total = torch.zeros((), device=pixels.device)
        smooth = {"albedo": weights.smooth_albedo, "roughness": weights.smooth_roughness, "metallic": weights.smooth_roughness}
        for name, weight in smooth.items():
            texture = self.parameters.get(name)
            if weight and texture is not None and name not in frozen:
                total = total + weight * smoothness(fetch(texture, uv), fetch(texture, neighbours.uv[other]), similarity)
        return total

    # ---- start and prior------------------------------------------------------------------------------------------

    def _initial_albedo(self) -> None:
        """The prior's albedo averaged over the views in texture space, or ``albedo_initial`` in the images' mean colour."""
        targets, mean = self.supervision.targets, self.images.mean(0)
        colour = self.settings.albedo_initial * mean / mean.mean().clamp_min(1e-8)
        colour = colour / colour.max().clamp_min(1.0)
        with torch.no_grad():
            self.parameters["albedo"].copy_(colour.clamp(0, 1).expand_as(self.parameters["albedo"]))
        if self.supervision.sets_albedo and self.settings.weights.albedo:  # a prior switched off must not leak in here
            gbuffer, target = self.problem.gbuffer, targets.values["albedo"]
            hit = (gbuffer.face >= 0) & (targets.weights["albedo"] > 0)
            uv = self.problem.renderer.surface.uv(gbuffer.face[hit].long(), gbuffer.barycentric[hit])
            covered = (hit.float().mean(1, keepdim=True)).clamp_min(1e-6)
            values = (target / covered)[:, None].expand(-1, gbuffer.subsamples, -1)[hit]
            average, weight = splat(uv, values, self.problem.plan.texture)
            with torch.no_grad():
                self.parameters["albedo"].copy_(fill_unobserved(average, weight > 0).clamp(0, 1))

    def _initial_light(self) -> None:
        """A constant light that gives the initial material the images' mean colour (render once under light 1)."""
        gbuffer = self.problem.gbuffer
        count = min(8192, len(gbuffer.pixel))
        pixels = torch.randint(len(gbuffer.pixel), (count,), generator=self.generator, device=gbuffer.pixel.device)
        with torch.no_grad():
            material = self._material()
            ones = SampledLight.of(torch.ones_like(self.parameters["log_light"]))
            rendered = self._render(pixels, material, ones, self.problem.plan.samples)
            self.guard.check_loss(rendered.radiance.sum(), pixels, {"the first render's radiance": rendered.radiance})
            mean = self.images.mean(0).clamp_min(1e-8)
            self.parameters["log_light"] += torch.log(mean / rendered.radiance.mean(0).clamp_min(1e-8))

    def _renders(self, views: tuple[int, ...], components: frozenset[str]) -> Images:
        """Current renders (V, H, W, 3) of ``components``, of some views; on the CPU, where a prior is asked."""
        material = self._material(detached=True)
        light = SampledLight.of(torch.exp(self.parameters["log_light"].detach()))
        renderer, (part, _) = self.problem.renderer, restrict(self.problem.gbuffer, views)
        if components == {"albedo"}:  # no light, no samples
            return {"albedo": texture_images(renderer.surface, part, material.albedo).cpu()}
        images = renderer.render_images(part, material, light, GUIDE_SAMPLES, self.generator)
        return {name: images[name].cpu() for name in sorted(components)}

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """The time of what happens inside is the prior's, and so is that of samples kept from an earlier run."""
        started, kept = time.perf_counter(), self.sampler.kept_seconds
        yield
        self.seconds["prior"] += time.perf_counter() - started + self.sampler.kept_seconds - kept

    def _draw(self, *, guided: bool) -> None:
        """Sample the prior; what is distilled is not sampled, so nothing supervises before the first distillation."""
        with self._asking():
            views, targets = self.sampler.views, Targets({}, {})
            if self.problem.supervision.kind != "sds":
                samples = self.sampler.draw(self._renders(views, self._supervising) if guided else None)
                targets = make_targets(self.problem, samples, views)
            self._supervise(targets)

    def _distill(self) -> None:
        """Every ``sds_period`` steps, of kind "sds": let the prior denoise the current renders of a few views."""
        supervision = self.problem.supervision
        if supervision.kind != "sds" or self.step % supervision.sds_period or not self.prior.info.provides:
            return
        with self._asking():
            random = np.random.default_rng((self.seed, self.step))
            count = min(supervision.sds_views, len(self.sampler.views))
            views = tuple(sorted(int(view) for view in random.choice(self.sampler.views, count, replace=False)))
            estimates = self.sampler.distill(self._renders(views, self.prior.info.provides), views, int(random.integers(2**63)))
            self._supervise(make_targets(self.problem, estimates, views))

    def _supervise(self, targets: Targets) -> None:
        self.supervision = Supervision(self.problem, self.prior, self.settings.ssi, targets)

    # ---- scoring and checkpoints -------------------------------------------------------------------------------

    def _pause(self, stage: str) -> None:
        """Off the clock: score at doubling steps, and keep the state from time to time."""
        ratio = self.step / FIRST_SCORE
        if self.step < self.steps and ratio >= 1 and math.log2(ratio).is_integer():
            self.monitor.score(stage, self.step, sum(self.seconds.values()), self._snapshot(final=False))
        due = time.monotonic() - self.saved >= self.settings.checkpoint_seconds and self.step < self.steps
        if due or self.monitor.stopping():
            self.monitor.save(self._state())
            self.saved = time.monotonic()

    def _snapshot(self, *, final: bool) -> Fit:
        textures = {name: p.detach().clone() for name, p in self.parameters.items() if name != "log_light"}
        if final:
            textures = {name: fill_unobserved(texture, self._observed > 0) for name, texture in textures.items()}
        light = torch.exp(self.parameters["log_light"].detach())
        counters = {
            **self.sampler.counters,
            "skipped_steps": self.guard.skipped,
            "cast_blocked_steps": self.cast.blocked,
            "samples_per_pixel": self._samples_per_pixel,
        }
        return Fit(Material(**textures), light, dict(self.seconds), counters)

    def _state(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "seconds": dict(self.seconds),
            "generator": self.generator.get_state(),
            "parameters": {name: parameter.detach() for name, parameter in self.parameters.items()},
            "optimizer": self.optimizer.state_dict(),
            "cast": self.cast.state_dict(),
            "supervision": self.supervision.state(),
            "counters": dict(self.sampler.counters),
            "skipped": {"in_all": self.guard.skipped, "in_a_row": self.guard.in_a_row},
        }

    def _restore(self, state: dict[str, Any]) -> None:
        shapes = {name: tensor.shape for name, tensor in state["parameters"].items()}
        if state["step"] not in range(self.steps + 1) or shapes != {name: p.shape for name, p in self.parameters.items()}:
            raise ValueError(f"step {state['step']} of {self.steps}, parameters of shapes {shapes}")
        self.step, self.seconds = state["step"], state["seconds"]
        self.generator.set_state(state["generator"])
        with torch.no_grad():
            for name, parameter in self.parameters.items():
                parameter.copy_(state["parameters"][name])
        self.optimizer.load_state_dict(state["optimizer"])
        self.cast.load_state_dict(state["cast"])
        supervision = _on(self.problem.gbuffer.face.device, state["supervision"])  # checkpoints are read on the CPU
        self._supervise(Targets(**supervision["targets"]))
        self.supervision.restore_alignment(supervision["alignment"])
        self.sampler.counters = state["counters"]
        self.guard.skipped, self.guard.in_a_row = state["skipped"]["in_all"], state["skipped"]["in_a_row"]
        self.monitor.note(f"resumed at step {self.step} of {self.steps}")


def _on(device: torch.device, state: Any) -> Any:  # noqa: ANN401 (what a checkpoint may hold)
    """``state`` with the tensors of its dicts moved to ``device``."""
    if isinstance(state, dict):
        return {name: _on(device, value) for name, value in state.items()}
    return state.to(device) if isinstance(state, torch.Tensor) else state


def _check_images(problem: Problem) -> None:
    for view in problem.scene.train:
        bad = int((~np.isfinite(view.image)).sum())
        if bad:
            raise FloatingPointError(f"training view {view.name}: NaN or Inf in {bad} values of the image")
