"""Asking the prior about the training views, and keeping account of what that costs."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.asking.geometry import view_geometry
from ia_bench.methods.asking.sample_cache import SampleCache, StoredSample, content_key
from ia_bench.methods.asking.views import evenly_spread
from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Bounded, Counted, Distiller, Fingerprinted, GeometryReader, Prior
from ia_bench.render.atlas import cache_folder

Images = dict[str, Tensor]  # component -> (V, H, W, 3)


class PriorSampler:
    """The prior as the trainer asks it: about the views of ``problem.supervision.views``, each answer checked.

    ``views``: which training views these are. ``counters``: "network_calls" spent and what a Counted prior counts, among
    them those of samples that were kept from an earlier run, and "prior_cached", how many draws these are.
    ``kept_seconds``: what the kept draws took when they were made, so that error against time stays comparable.
    """

    def __init__(self, problem: Problem, prior: Prior, seed: int) -> None:
        """Raises InputError when distillation is asked of a prior that has none."""
        self._problem, self._prior, self._seed = problem, prior, seed
        settings = problem.supervision
        if settings.kind == "sds" and not isinstance(prior, Distiller):
            raise InputError(
                f"prior.supervision.kind=sds: expected a prior with a method distill(images, masks, renders, *, seed), "
                f"found {type(prior).__name__}, which has none"
            )
        self.views = evenly_spread(problem.scene, problem.plan.prior_views if settings.views == "auto" else settings.views)
        self.counters = {"prior_cached": 0, **dict.fromkeys(self._counted(), 0)}
        self.kept_seconds = 0.0
        self._given: tuple[int, ...] | None = None  # the views whose geometry the prior holds
        keeps = settings.cache and isinstance(prior, Fingerprinted) and not prior.sees_truth  # truth is in no key
        self._cache = SampleCache(cache_folder()) if keeps else None

    def draw(self, guidance: Images | None) -> Images:
        """A sample of every view asked, linear and premultiplied. ``guidance``: current renders of the same views.

        Raises ValueError when the prior breaks its contract (wrong components, shapes, NaN): its user needs to know which.
        """
        images, masks = self._photographs(self.views)
        cache = self._cache if guidance is None else None
        key = self._key(images, masks) if cache is not None else ""
        stored = cache.load(key) if cache is not None else None
        if stored is not None:
            self.counters["prior_cached"] += 1
            self._count(stored.counters)
            self.kept_seconds += stored.seconds
            return stored.sample

        def ask() -> Images:
            return self._prior.sample(images, masks, seed=self._seed, guidance=guidance)

        started = time.perf_counter()
        sample, counted = self._ask(ask, self.views, set(self._prior.provides), images.shape)
        if cache is not None:
            cache.store(key, StoredSample(sample, time.perf_counter() - started, counted))
        return sample

    def ceilings(self) -> Images:
        """Component -> (V,): where the samples of the views asked end, for those that do."""
        return self._prior.ceilings(*self._photographs(self.views)) if isinstance(self._prior, Bounded) else {}

    def distill(self, renders: Images, views: tuple[int, ...], seed: int) -> Images:
        """The prior's estimates of the current renders of some views. Raises ValueError like :meth:`draw`."""
        images, masks = self._photographs(views)
        prior = self._prior
        assert isinstance(prior, Distiller)

        def ask() -> Images:
            return prior.distill(images, masks, renders, seed=seed)

        return self._ask(ask, views, set(renders), images.shape)[0]

    def _ask(
        self, ask: Callable[[], Images], views: tuple[int, ...], expected: set[str], shape: torch.Size
    ) -> tuple[Images, dict[str, int]]:
        """The checked answer, and what was counted for it."""
        prior = self._prior
        if isinstance(prior, GeometryReader) and prior.reads_geometry and self._given != views:
            prior.give_geometry(*view_geometry(self._problem, views))
            self._given = views
        before = self._counted()
        samples = ask()
        counted = {name: count - before.get(name, 0) for name, count in self._counted().items()}
        self._count(counted)
        _check(samples, expected, shape)
        return samples, counted

    def _counted(self) -> dict[str, int]:
        """What the prior has counted since it was made."""
        own = self._prior.counters if isinstance(self._prior, Counted) else {}
        return {"network_calls": self._prior.network_calls, **own}

    def _count(self, counted: Mapping[str, int]) -> None:
        for name, count in counted.items():
            self.counters[name] = self.counters.get(name, 0) + count

    def _photographs(self, views: tuple[int, ...]) -> tuple[Tensor, Tensor]:
        chosen = [self._problem.scene.train[view] for view in views]
        images = torch.stack([torch.from_numpy(view.image) for view in chosen])
        return images, torch.stack([torch.from_numpy(view.mask) for view in chosen])

    def _key(self, images: Tensor, masks: Tensor) -> str:
        """What decides a sample; geometry by what it is computed from."""
        prior = self._prior
        assert isinstance(prior, Fingerprinted)
        rounding = f"torch {torch.__version__}, {torch.get_num_threads()} threads"  # the last bits depend on both
        parts: list[str | Tensor] = [prior.fingerprint, rounding, str(self._seed), images, masks]
        if isinstance(prior, GeometryReader) and prior.reads_geometry:
            mesh, shadows = self._problem.scene.mesh, type(self._problem.renderer.visibility).__name__
            cameras = [self._problem.scene.train[view].camera for view in self.views]
            digest = hashlib.sha256(f"{shadows} {self._problem.gbuffer.subsamples}".encode())
            for array in (mesh.vertices, mesh.faces, mesh.normals, mesh.uv, *(camera.to_world for camera in cameras)):
                digest.update(np.ascontiguousarray(array).tobytes())
            digest.update(repr([(camera.focal, camera.centre) for camera in cameras]).encode())
            parts.append(digest.hexdigest())
        return content_key(*parts)


def _check(samples: Mapping[str, Tensor], expected: set[str], shape: torch.Size) -> None:
    if set(samples) != expected:
        raise ValueError(f"the prior provides {sorted(expected)} but sampled {sorted(samples)}")
    for name, sample in samples.items():
        if sample.shape != shape:
            raise ValueError(f"the prior's {name} has shape {tuple(sample.shape)}, expected {tuple(shape)}")
        if not bool(torch.isfinite(sample).all()):
            raise ValueError(f"the prior's {name} has NaN or Inf in {int((~torch.isfinite(sample)).sum())} values")
