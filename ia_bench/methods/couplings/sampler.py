"""Asks the prior about the training views, keeps its samples between runs, counts what that costs, and spreads them over pixels."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext

import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key
from ia_bench.common.machine import instructions
from ia_bench.methods.contract import PixelSamples, Problem
from ia_bench.methods.photographs import count_views, restrict, stacked, view_geometry
from ia_bench.priors.contract import Distiller, Observations, Prior, Samples
from ia_bench.priors.validation import (
    LARGEST,
    ask,
    ask_to_distill,
    ask_to_refine,
    beyond_a_material,
    check_prior_info,
    fingerprint_of,
    name_of,
    refiner_of,
)

GEOMETRY = ("normals", "visibility")
SAMPLE_PARTS = ("values/", "ceilings/")  # of samples that are kept
NEAR_CEILING = 0.8
"""Share of the largest value that a prior can say from which a sample means "at least": a mean of draws stays below it."""
Images = dict[str, Tensor]  # component -> (V, H, W, 3)


class PriorSampler:
    """The prior as a method asks it: about the views of ``problem.asked_views``.

    Attributes:
        counters: What the prior has cost, such as "network_calls", those of samples that were kept from an earlier run
            among it; "prior_cached", how many draws these are; "prior_absurd_values", how many values of its answers no image
            could hold.
        kept_seconds: What the kept draws took when they were made, so that error against time stays comparable.
        last_views: Those that the prior was asked about last, be it before an interruption.
    """

    def __init__(self, problem: Problem, prior: Prior, seed: int, note: Callable[[str], None]) -> None:
        """``note``: where the user is told what is odd."""
        check_prior_info(prior)
        self._problem, self._prior, self._seed, self._note = problem, prior, seed, note
        self.counters = {"prior_cached": 0, "prior_absurd_values": 0, "network_calls": 0}
        self.kept_seconds = 0.0
        self.last_views: tuple[int, ...] = ()
        self._shown: Observations | None = None
        self._told = False
        self._fingerprint = fingerprint_of(prior)
        self._keeps = problem.keep_samples and self._fingerprint is not None and not prior.info.sees_truth  # truth is in no key

    def draw(self, guidance: Images | None) -> Samples:
        """A sample of every view asked. ``guidance``: current renders of the same views. Raises InputError for no sound one."""
        observations = self._observations(self._problem.asked_views)
        key = self._key(observations) if self._keeps and guidance is None else None
        stored = None if key is None else Cache().get(key)
        if stored is not None:
            tensors, about = stored
            values, ceilings = (
                {key.removeprefix(part): value for key, value in tensors.items() if key.startswith(part)} for part in SAMPLE_PARTS
            )
            samples = Samples(values, ceilings, about["cost"])
            self.counters["prior_cached"] += 1
            self.kept_seconds += about["seconds"]
            self._problem.costs.cpu_left_out -= about.get("cpu_seconds", about["seconds"])
        else:
            started, cpu_started = time.perf_counter(), time.process_time()
            samples = ask(self._prior, observations, seed=self._seed, guidance=guidance)
            if key is not None:
                parts = zip(SAMPLE_PARTS, (samples.values, samples.ceilings), strict=True)
                tensors = {part + name: value for part, of in parts for name, value in of.items()}
                took = {"seconds": time.perf_counter() - started, "cpu_seconds": time.process_time() - cpu_started}
                Cache().put(key, tensors, {**took, "cost": dict(samples.cost)})
        wrong = None if self._told else beyond_a_material(samples, observations.masks)
        if wrong is not None:
            self._told = True
            self._note(f"prior {name_of(self._prior)} proposes {wrong}; it is used, and ia-bench check says more")
        return self._accounted(samples)

    def distill(self, renders: Images, views: tuple[int, ...], seed: int) -> Samples:
        """The prior's estimates of the current renders of some views. Raises InputError like :meth:`draw`."""
        assert isinstance(self._prior, Distiller)
        return self._accounted(ask_to_distill(self._prior, self._observations(views), renders, seed=seed))

    def refine(self, renders: Images) -> Samples:
        """What the prior makes of the fit's ``renders`` of the views asked. Raises InputError like :meth:`draw`."""
        return self._accounted(ask_to_refine(refiner_of(self._prior), self._observations(self._problem.asked_views), renders))

    def _accounted(self, samples: Samples) -> Samples:
        for name, count in samples.cost.items():
            self.counters[name] = self.counters.get(name, 0) + count
        absurd = sum(int(((value < 0) | (value > LARGEST)).sum()) for value in samples.values.values())
        if absurd and not self.counters["prior_absurd_values"]:
            self._note(f"prior {name_of(self._prior)}: {absurd} of its values are negative or above {LARGEST:g}; they are used")
        self.counters["prior_absurd_values"] += absurd
        return samples

    def _observations(self, views: tuple[int, ...]) -> Observations:
        """What the prior is shown of some training views; that of the last ones is kept, for geometry takes rays."""
        if self._shown is None or self._shown.views != views:
            chosen, wants = [self._problem.scene.train[view] for view in views], self._prior.info.wants
            images, masks = stacked(chosen, "image"), stacked(chosen, "mask")
            again = self._shown is None and self.last_views == views  # the process before the interruption has counted its rays
            with self._problem.costs.exclude("bake") if again else nullcontext():
                seen = view_geometry(self._problem, views) if wants & set(GEOMETRY) else (None, None)
                view_count = count_views(self._problem, views) if "view_count" in wants else None
            normals, visibility = (tensor if name in wants else None for name, tensor in zip(GEOMETRY, seen, strict=True))
            names, sizes = tuple(view.name for view in chosen), tuple(view.taken or view.mask.shape for view in chosen)
            self._shown = Observations(images, masks, views, normals, visibility, view_count, names=names, sizes=sizes)
            self.last_views = views
        return self._shown

    def _key(self, shown: Observations) -> str:
        """What decides a sample: the prior, the seed and all that is shown."""
        # the last bits depend on these
        rounding = f"torch {torch.__version__}, {torch.get_num_threads()} threads, {' '.join(instructions())}"
        about = repr((self._seed, shown.views, shown.names))
        geometry = [tensor for tensor in (shown.normals, shown.visibility, shown.view_count) if tensor is not None]
        return content_key("samples", str(self._fingerprint), rounding, about, shown.images, shown.masks, *geometry)


def pixel_samples(problem: Problem, samples: Samples, views: tuple[int, ...]) -> PixelSamples:
    """Samples, or distilled estimates, of the ``views`` of the problem."""
    part, rows = restrict(problem.gbuffer, views)
    view = part.view()
    values, at_least = {}, {}
    for name, sample in sorted(samples.values.items()):
        value = sample.to(rows.device).reshape(-1, 3)[part.pixel]
        values[name] = _among_zeros(problem, rows, value)
        if name in samples.ceilings:
            near = value.amax(-1) >= NEAR_CEILING * samples.ceilings[name].to(rows.device)[view]
            at_least[name] = _among_zeros(problem, rows, near[:, None].float()) > 0
    asked = _among_zeros(problem, rows, (~problem.photographs.left_out[rows, None]).float())
    return PixelSamples(values, asked / asked.mean().clamp_min(1e-12), at_least)


def _among_zeros(problem: Problem, rows: Tensor, values: Tensor) -> Tensor:
    """(P', C) values of the G-buffer's entries (P',) among zeros for all others: (P, C)."""
    everywhere = torch.zeros(len(problem.gbuffer.pixel), values.shape[-1], device=values.device)
    everywhere[rows] = values
    return everywhere
