"""What a fit asks its prior, and when: once before stage 1, again before stage 2, or every few steps if it is distilled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Monitor, PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.sampler import Images, PriorSampler, pixel_samples
from ia_bench.methods.photographs import as_photographed, restrict
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.priors.contract import Distiller
from ia_bench.priors.validation import name_of
from ia_bench.render.renderer import texture_images

GUIDE_SAMPLES = 32  # per pixel, for the renders that guide stage 2 or are distilled


class PriorLoss:
    """The prior's part of equation 5: the problem's coupling, and the questions that give it its samples.

    Attributes:
        sampler: What asks the prior.
        samples: What it said last; None before the first answer, and of a prior that says nothing.
    """

    def __init__(self, problem: Problem, seed: int, monitor: Monitor) -> None:
        """Raises InputError for a prior that is to be distilled and cannot be."""
        self._problem, self._seed, self._task = problem, seed, monitor.task
        self._prior, self._coupling = problem.prior, problem.coupling
        self.sampler = PriorSampler(problem, self._prior, seed, monitor.note)
        self.samples: PixelSamples | None = None
        self._used = self._coupling.uses(self._prior.info.provides)
        if self._coupling.period and not isinstance(self._prior, Distiller):
            expected = f"coupling: it asks again every {self._coupling.period} steps, so expected"
            method = "a prior with a method distill(observations, renders, *, seed)"
            raise InputError(f"{expected} {method}, found {name_of(self._prior)}, which has none")

    @property
    def says_albedo(self) -> bool:
        """Whether losses say which albedo a pixel has, so that photographs alone do not decide it when all steps are done."""
        return self._coupling.says_albedo and "albedo" in self._used

    @property
    def start(self) -> PixelSamples | None:
        """The samples that say where the albedo starts; None if there are none. A prior switched off must not leak in here."""
        return self.samples if self._coupling.sets_albedo and "albedo" in self._used else None

    def draw(self, parameters: Parameters | None, generator: torch.Generator) -> None:
        """Sample the prior, toward the current renders of ``parameters`` if they are given; not one that has no weight."""
        if self._coupling.period or not self._used:
            return
        views = self._problem.asked_views
        bar = self._task("views shown to the prior", len(views), 0)
        guidance = None if parameters is None else self._renders(parameters, views, self._used, generator)
        self._take(pixel_samples(self._problem, self.sampler.draw(guidance), views))
        bar.advance(len(views))

    def update(self, step: int, parameters: Parameters, generator: torch.Generator) -> None:
        """Before ``step``: where it is due, let the prior denoise the current renders of a few views."""
        coupling = self._coupling
        if not coupling.period or step % coupling.period or not self._used:
            return
        random = np.random.default_rng((self._seed, step))
        asked = self._problem.asked_views
        views = tuple(sorted(int(view) for view in random.choice(asked, min(coupling.views, len(asked)), replace=False)))
        renders = self._renders(parameters, views, self._prior.info.provides, generator)
        estimates = self.sampler.distill(renders, views, int(random.integers(2**63)))
        self._take(pixel_samples(self._problem, estimates, views))

    def losses(self, render: StepRender, pixels: Tensor, step: int) -> dict[str, Tensor]:
        """Those of the coupling, lambda_2 and lambda_3 of equation 5, at G-buffer entries (B,)."""
        if self.samples is None:
            return {}
        self._coupling.update(render.texture.detach(), step)
        return dict(self._coupling.loss(render, pixels))

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint must hold: the samples, what the coupling made of them, what the prior has cost and saw last."""
        said = None if self.samples is None else {"samples": dict(vars(self.samples)), "coupling": self._coupling.state()}
        return {"said": said, "counters": dict(self.sampler.counters), "views": list(self.sampler.last_views)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take over a :meth:`state_dict`."""
        if (said := state["said"]) is not None:
            kept, device = said["samples"], self._problem.device  # checkpoints are read on the CPU
            values, at_least = ({name: part.to(device) for name, part in kept[key].items()} for key in ("values", "at_least"))
            self._take(PixelSamples(values, kept["weight"].to(device), at_least))
            self._coupling.restore(said["coupling"])
        self.sampler.counters, self.sampler.last_views = dict(state["counters"]), tuple(state["views"])

    def _take(self, samples: PixelSamples) -> None:
        self.samples = samples
        self._coupling.prepare(samples, self._problem)

    def _renders(
        self, parameters: Parameters, views: tuple[int, ...], components: frozenset[str], generator: torch.Generator
    ) -> Images:
        """Current renders (V, H, W, 3) of ``components``, of some views; on the CPU, where a prior is asked."""
        material, light = parameters.material(detached=True), parameters.light()
        renderer, (part, _) = self._problem.renderer, restrict(self._problem.gbuffer, views)
        images: dict[str, Tensor]
        if components == {"albedo"}:  # no light, no samples
            images = {"albedo": texture_images(renderer.surface, part, material.albedo)}
        else:
            rendered = renderer.render_images(part, material, light, GUIDE_SAMPLES, generator)
            images = as_photographed(rendered, views, parameters.exposures)
        return {name: images[name].detach().cpu() for name in sorted(components)}
