"""The published IntrinsicAnything weights behind the prior's contract, sampled as their authors' code does.

docs/original_weights.md lists where this departs from that code, and why.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.ranges import NotNegative, Number, UnitInterval
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion.guidance import GuidanceReport
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample
from ia_bench.priors.inputs import Device, check_views, choose_device, content_number
from ia_bench.priors.original.convert import RECORD
from ia_bench.priors.original.guidance import pull
from ia_bench.priors.original.networks import Networks
from ia_bench.priors.original.preparation import Crop, decode, encode

LATENT_RANGE = (-20.0, 20.0)
"""Clip of the estimated latents, which have unit standard deviation: no sample reaches it, runaway guidance ends there."""

VERSION = 2
"""Part of the fingerprint; raised when a change of the code changes samples."""


class IntrinsicAnythingPrior:
    """Latent diffusion of albedo and of specular shading given an image, at 256 x 256.

    ``weights``: folder that ``python -m ia_bench_training.convert_weights`` wrote. ``components``: which models to use,
    None for all that are there. ``steps``, ``eta``: of DDIM; the authors' are 100 (200 for high-resolution patches) and 1.
    ``guidance_strength``: the authors' scale, recommended from 2 to 5 (:mod:`ia_bench.priors.original.guidance`).
    ``batch``: images at a time, which changes no sample beyond rounding. ``device``: "auto", "cpu", "cuda".
    Its cost counts guided estimates and those whose step was cut. Raises InputError.
    """

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
        if weights is None:
            raise InputError("prior.options.weights: expected the folder that python -m ia_bench_training.convert_weights wrote")
        self._folder = Path(weights).expanduser()
        self._records = _records(self._folder, components)
        self._side = _resolution(self._folder, sorted(self._records))
        self.info = PriorInfo(frozenset(self._records), stochastic=True, guidable=True, resolution=self._side)
        self._device = choose_device(device)
        self._settings = SamplerSettings(steps, eta, "leading", LATENT_RANGE)
        self._batch = batch
        self._loaded: dict[str, Networks] = {}
        self.guidance_strength = guidance_strength

    @property
    def fingerprint(self) -> str:
        """What decides the samples: this code's version, the options, the hashes of the checkpoints, the precision."""
        options = (self._settings.steps, self._settings.eta, self.guidance_strength, self._side, self._device.type)
        return json.dumps([type(self).__qualname__, VERSION, options, self._records], sort_keys=True)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`; radiance above 1 is clipped before the network sees it.

        An image's noise is seeded by ``seed``, the component and the image's own content, so that views differ in it.
        """
        check_views("intrinsicanything", observations, guidance or {}, self.info.provides)
        images, masks, report, cost = observations.images, observations.masks, GuidanceReport(), Counter(network_calls=0)
        crops = [Crop.of(mask, self._side) for mask in masks]
        seen = {view: crop for view, crop in enumerate(crops) if crop is not None}  # there is nothing to say of the others
        samples = {}
        for component in sorted(self.info.provides):
            samples[component] = torch.zeros_like(images, dtype=torch.float32)
            for start in range(0, len(seen), self._batch):
                views = list(seen)[start : start + self._batch]
                squares = self._squares(images, masks, views, seen)
                render = guidance.get(component) if guidance else None
                target = None if render is None else self._squares(render, masks, views, seen)
                contents = [content_number(images[view], masks[view]) for view in views]
                seeds = [derive_seed(seed, COMPONENTS.index(component), content) for content in contents]
                drawn = self._draw(component, squares, seeds, target, report, cost)
                for view, square in zip(views, drawn, strict=True):
                    samples[component][view] = decode(square, masks[view], seen[view])
        ceilings = {"specular": torch.ones(len(images))} if "specular" in samples else {}  # a square ends at white
        return Samples(samples, ceilings, {**cost, **report.counters})

    def _draw(
        self,
        component: str,
        images: Tensor,
        seeds: list[int],
        target: Tensor | None,
        report: GuidanceReport,
        cost: Counter[str],
    ) -> Tensor:
        """(N, 3, S, S) in the networks' encoding, like ``images`` and ``target``."""
        networks = self._networks(component)
        condition = networks.condition(images)
        target = None if target is None or self.guidance_strength == 0 else target.to(self._device)

        def denoise(noisy: Tensor, t: int) -> Tensor:
            cost["network_calls"] += len(noisy)
            x0 = networks.estimate(noisy, t, condition)
            if target is None:
                return x0
            level = float(networks.schedule.alpha_bar[t])
            return pull(x0, target, networks.decode, self.guidance_strength, level, report)

        shape = networks.latent_shape(len(images), self._side)
        latents = sample(denoise, networks.schedule, shape, seeds, self._settings, device=self._device)
        with torch.no_grad():
            return networks.decode(latents).cpu()

    def _squares(self, images: Tensor, masks: Tensor, views: list[int], crops: Mapping[int, Crop]) -> Tensor:
        return torch.stack([encode(images[view], masks[view], crops[view], self._side) for view in views])

    def _networks(self, component: str) -> Networks:
        if component not in self._loaded:
            self._loaded[component] = Networks(self._folder / component, self._device)
        return self._loaded[component]


def _records(folder: Path, components: Iterable[str] | None) -> dict[str, str]:
    """SHA-256 of the checkpoint behind every component wanted, all that are in ``folder`` for None."""
    wanted = COMPONENTS if components is None else tuple(components)
    unknown = sorted(set(wanted) - set(COMPONENTS))
    if unknown or not wanted:
        found = ", ".join(unknown) or "none"
        raise InputError(f"prior.options.components: expected some of {', '.join(COMPONENTS)}, found {found}")
    present = [component for component in wanted if (folder / component / RECORD).is_file()]
    absent = sorted(set(wanted) - set(present))
    if not present or (components is not None and absent):
        raise InputError(
            f"prior.options.weights={folder}: expected {' or '.join(absent)} as python -m ia_bench_training.convert_weights "
            f"writes it, found no {RECORD} there"
        )
    records = {}
    for component in present:
        path = folder / component / RECORD
        try:
            records[component] = str(read_json(path)["sha256"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: expected JSON with the key sha256, found {error}") from None
    return records


def _resolution(folder: Path, components: list[str]) -> int:
    sides = {}
    for component in components:
        path = folder / component / "vae" / "config.json"
        try:
            sides[component] = int(read_json(path)["sample_size"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: expected JSON with the key sample_size, found {error}") from None
    if len(set(sides.values())) != 1:
        raise InputError(f"prior.options.weights={folder}: expected models of one resolution, found {sides}")
    return sides[components[0]]
