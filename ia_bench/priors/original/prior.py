"""The published IntrinsicAnything weights behind the prior's contract, sampled as their authors' code does.

docs/original_weights.md lists where this departs from that code, and why.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.ranges import NotNegative, Number, UnitInterval
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion.guidance import GuidanceReport
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample
from ia_bench.priors.inputs import Device, check_views, choose_device, content_number
from ia_bench.priors.original.networks import RECORD, Networks, pull
from ia_bench.priors.original.preparation import Crop, decode, encode

LATENT_RANGE = (-20.0, 20.0)
"""Clip of the estimated latents, which have unit standard deviation: no sample reaches it, runaway guidance ends there."""

VERSION = 2
"""Part of the fingerprint; raised when a change of the code changes samples."""


class IntrinsicAnythingPrior:
    """Latent diffusion of albedo and of specular shading given an image, at 256 x 256.

    ``weights``: folder with what ``python -m ia_bench_training.convert_weights`` wrote, a folder a component. ``components``: which
    models to use, None for all that are there. ``steps``, ``eta``: of DDIM; the authors' are 100 (200 for high-resolution patches)
    and 1. ``guidance_strength``: the authors' scale, recommended from 2 to 5 (:func:`ia_bench.priors.original.networks.pull`).
    ``batch``: images at a time, which changes no sample beyond rounding. ``device``: "auto", "cpu", "cuda".
    Its cost counts guided estimates and those whose step was cut. Raises InputError.
    """

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[str]:
        """What samples depend on beside code and options: the weights."""
        return [options["weights"]] if options.get("weights") else []

    def __init__(
        self,
        *,
        weights: str | None = None,
        components: Iterable[str] | None = None,
        steps: Number = 100,
        eta: UnitInterval = 1.0,
        guidance_strength: NotNegative = 3.0,
        batch: Number = 8,
        device: Device = "auto",
    ) -> None:
        folder = Path(weights or "").expanduser()
        there = [name for name in COMPONENTS if weights and is_file(folder / name / RECORD)]
        used = there if components is None else sorted(set(components))
        if not used or not set(used) <= set(there):
            expected = " and ".join(used) or "albedo or specular"
            raise InputError(
                f"prior.options.weights={weights}: expected {expected}/{RECORD} as python -m ia_bench_training.convert_weights "
                f"writes it, found {', '.join(there) or 'none'}"
            )
        self._hashes = {name: _entry(folder / name / RECORD, "sha256") for name in used}
        self._side = int(_entry(folder / used[0] / "vae" / "config.json", "sample_size"))
        self.info = PriorInfo(frozenset(used), stochastic=True, guidable=True, resolution=self._side, coupling="targets")
        self._device = choose_device(device)
        self._settings = SamplerSettings(steps, eta, "leading", LATENT_RANGE)
        self._batch = batch
        self._networks = cache(lambda component: Networks(folder / component, self._device))
        self.guidance_strength = guidance_strength

    @property
    def fingerprint(self) -> str:
        """What decides the samples: this code's version, the options, the hashes of the checkpoints, the precision."""
        options = (self._settings.steps, self._settings.eta, self.guidance_strength, self._side, self._device.type)
        return json.dumps([type(self).__qualname__, VERSION, options, self._hashes], sort_keys=True)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`; radiance above 1 is clipped before the network sees it.

        An image's noise is seeded by ``seed``, the component and the image's own content, so that views differ in it.
        """
        check_views("intrinsicanything", observations, guidance or {}, self.info.provides)
        images, masks = observations.images, observations.masks
        report, cost = GuidanceReport(), Counter(network_calls=0)
        crops = {view: crop for view, mask in enumerate(masks) if (crop := Crop.of(mask, self._side)) is not None}
        samples = {name: torch.zeros_like(images, dtype=torch.float32) for name in sorted(self.info.provides)}

        def squares(linear: Tensor, views: list[int]) -> Tensor:
            return torch.stack([encode(linear[view], masks[view], crops[view], self._side) for view in views])

        for component, sampled in samples.items():
            number, render = COMPONENTS.index(component), (guidance or {}).get(component)
            for start in range(0, len(crops), self._batch):
                views = list(crops)[start : start + self._batch]
                seeds = [derive_seed(seed, number, content_number(images[view], masks[view])) for view in views]
                target = None if render is None else squares(render, views)
                drawn = self._draw(self._networks(component), squares(images, views), seeds, target, report)
                cost["network_calls"] += self._settings.steps * len(views)
                for view, square in zip(views, drawn, strict=True):
                    sampled[view] = decode(square, masks[view], crops[view])
        ceilings = {"specular": torch.ones(len(images))} if "specular" in samples else {}  # a square ends at white
        return Samples(samples, ceilings, {**cost, **report.counters})

    def _draw(self, networks: Networks, images: Tensor, seeds: list[int], target: Tensor | None, report: GuidanceReport) -> Tensor:
        """(N, 3, S, S) in the networks' encoding, like ``images`` and ``target``."""
        schedule, free = networks.schedule, networks.bind(images)
        target = target.to(self._device) if target is not None and self.guidance_strength else None

        def denoise(noisy: Tensor, t: int) -> Tensor:
            x0 = free(noisy, t)
            if target is None:
                return x0
            return pull(x0, target, networks.decode, self.guidance_strength, float(schedule.alpha_bar[t]), report)

        shape = networks.latent_shape(len(images), self._side)
        latents = sample(denoise, schedule, shape, seeds, self._settings, device=self._device)
        with torch.no_grad():
            return networks.decode(latents).cpu()


def _entry(path: Path, key: str) -> Any:  # noqa: ANN401 (a JSON value)
    content = read_json(path)
    if key not in content:
        raise InputError(f"{path}: expected JSON with the key {key}, found none")
    return content[key]
