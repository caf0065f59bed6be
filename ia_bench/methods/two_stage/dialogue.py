"""What a fit asks its prior, and when: once before stage 1, again before stage 2, or every few steps if it is distilled."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.methods.asking.sampling import Images, PriorSampler
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Problem
from ia_bench.methods.state import Some
from ia_bench.methods.two_stage.parameters import Parameters
from ia_bench.methods.two_stage.refinement import as_photographed
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.supervision import Supervision
from ia_bench.methods.two_stage.targets import Targets, make_targets
from ia_bench.render.renderer import texture_images

GUIDE_SAMPLES = 32  # per pixel, for the renders that guide stage 2 or are distilled


class Dialogue:
    """The questions to the prior and the supervision that its last answer gives.

    Attributes:
        sampler: What asks the prior.
        supervision: The losses of the targets at hand; none before the first answer, and none of a prior that says nothing.
        seconds: What asking took, that of samples kept from an earlier run included.
        counters: What the prior counted, see :class:`ia_bench.methods.asking.sampling.PriorSampler`.
    """

    def __init__(self, problem: Problem, settings: FitSettings, seed: int, note: Callable[[str], None]) -> None:
        self._problem, self._settings, self._seed = problem, settings, seed
        self._prior = problem.prior
        self.sampler = PriorSampler(problem, self._prior, seed, note)
        self.seconds = 0.0
        self.supervise(Targets({}, torch.zeros(len(problem.gbuffer.pixel), 1, device=problem.device)))

    @property
    def counters(self) -> dict[str, int]:
        """See the class."""
        return self.sampler.counters

    @property
    def supervising(self) -> frozenset[str]:
        """The components of the prior that have a weight; one without guides nothing, and costs no renders."""
        mine = self._problem.supervision
        of_albedo = mine.kernel_weight if mine.kind == "similarity" else mine.target_weight
        weights = {
            "albedo": self._settings.weights.albedo * of_albedo,
            "specular": self._settings.weights.specular * mine.specular_weight,
        }
        return frozenset(name for name in self._prior.info.provides if weights[name])

    @property
    def draws_again(self) -> bool:
        """Whether stage 2 has guided samples."""
        wanted = self._settings.guided and self._problem.supervision.kind != "sds"
        return wanted and self._prior.info.guidable and bool(self.supervising)

    @property
    def start(self) -> Targets | None:
        """The targets that say where the albedo starts; None if there are none. A prior switched off must not leak in here."""
        return self.supervision.targets if self.supervision.sets_albedo and "albedo" in self.supervising else None

    def draw(self, parameters: Parameters | None, generator: torch.Generator) -> None:
        """Sample the prior, toward the current renders of ``parameters`` if they are given.

        What is distilled is not sampled, nor what has no weight.
        """
        if self._problem.supervision.kind == "sds" or not self.supervising:
            return
        with self._asking():
            views = self.sampler.views
            guidance = None if parameters is None else self._renders(parameters, views, self.supervising, generator)
            self.supervise(make_targets(self._problem, self.sampler.draw(guidance), views))

    def distill(self, step: int, parameters: Parameters, generator: torch.Generator) -> None:
        """Where ``step`` is due, of kind "sds": let the prior denoise the current renders of a few views."""
        settings = self._problem.supervision
        if settings.kind != "sds" or step % settings.sds_period or not self._prior.info.provides:
            return
        with self._asking():
            random = np.random.default_rng((self._seed, step))
            count = min(settings.sds_views, len(self.sampler.views))
            views = tuple(sorted(int(view) for view in random.choice(self.sampler.views, count, replace=False)))
            renders = self._renders(parameters, views, self._prior.info.provides, generator)
            estimates = self.sampler.distill(renders, views, int(random.integers(2**63)))
            self.supervise(make_targets(self._problem, estimates, views))

    def supervise(self, targets: Targets) -> None:
        """Put ``targets`` in the place of those at hand."""
        self.supervision = Supervision(self._problem, self._prior, self._settings.ssi, targets)

    def state(self) -> dict[str, Any]:
        """For a checkpoint; the targets are kept apart."""
        return {"alignment": self.supervision.alignment(), "counters": dict(self.counters)}

    def form(self) -> dict[str, Any]:
        """The form of :meth:`state`, for :func:`ia_bench.methods.state.check_form`."""
        return {"alignment": Some(self.supervision.form_of_alignment()), "counters": int}

    def form_of_targets(self) -> dict[str, Any]:
        """The form of the targets that are kept apart."""
        each = torch.zeros(len(self._problem.gbuffer.pixel), 3)
        values, at_least = (Some(dict.fromkeys(self._prior.info.provides, form)) for form in (each, each[:, :1] > 0))
        return {"values": values, "weight": each[:, :1], "at_least": at_least}

    def restore(self, state: dict[str, Any], targets: Targets, seconds: float) -> None:
        """Take over a :meth:`state`, its targets, and what the prior had taken until then."""
        self.supervise(targets.to(self._problem.device))
        self.supervision.restore_alignment(state["alignment"])
        self.sampler.counters, self.seconds = dict(state["counters"]), seconds

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """The time of what happens inside is the prior's, and so is that of samples kept from an earlier run."""
        started, kept = time.perf_counter(), self.sampler.kept_seconds
        yield
        self.seconds += time.perf_counter() - started + self.sampler.kept_seconds - kept

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
            exposures = None if parameters.exposures is None else parameters.exposures.recovered
            images = as_photographed(renderer.render_images(part, material, light, GUIDE_SAMPLES, generator), views, exposures)
        return {name: images[name].cpu() for name in sorted(components)}
