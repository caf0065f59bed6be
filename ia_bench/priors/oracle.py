"""Ground truth behind the prior's contract, with dials that spoil it in the ways in which learned priors fail.

Only priors that declare ``sees_truth`` (oracle, corrected) are shown ground truth, and every table marks them. With all dials
at zero this one is exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field
from scipy.ndimage import gaussian_filter
from torch import Tensor

from ia_bench.common.ranges import NotNegative
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples

MAX_SCALE = 10.0
"""Largest standard deviation of a log scale: eight of them still make a factor that a float holds."""

Spread = Annotated[float, Field(ge=0, le=MAX_SCALE)]


@dataclass(kw_only=True, eq=False)
class OraclePrior:
    """Per view, sample = exp(a) truth baked + inconsistency + noise, inside the mask.

    Guidance has a closed form, because the random part is Gaussian: with per-pixel prior variance
    v = noise^2 + inconsistency^2 + (scale truth)^2 and ``guidance_strength`` s (an inverse variance), the sample
    moves to (sample / v + s render) / (1 / v + s), the mean of the product of the two Gaussians around the sample drawn.
    s = 0 returns the unguided sample to the bit, and so does an exact oracle (v = 0) at any strength.

    Attributes:
        components: What it provides.
        scale: Standard deviation of the log scale a, one draw per view.
        noise: That of white pixel noise, in units of the component's mean over all images asked about.
        baked: Exponent beta of shading left in the albedo, which is multiplied by (luminance / mean luminance of the image)^beta.
        inconsistency: Standard deviation (same units) of smooth patches, drawn anew per view.
        patch: Size of a smooth patch in pixels.
    """

    components: Iterable[Literal["albedo", "specular"]] = ("albedo", "specular")
    scale: Spread = 0.0
    noise: NotNegative = 0.0
    baked: NotNegative = 0.0
    inconsistency: NotNegative = 0.0
    patch: NotNegative = 8.0
    guidance_strength: NotNegative = 100.0

    def __post_init__(self) -> None:
        stochastic = any((self.scale, self.noise, self.inconsistency))
        provides, wants = frozenset(self.components), frozenset({"truth"})
        self.info = PriorInfo(provides, stochastic, guidable=True, sees_truth=True, wants=wants, coupling="targets")

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`. An image's draw is seeded by its place among the others.

        So with noise a sample does depend on how many images stand before its own, unlike those of other priors.
        """
        truths, guidance = observations.truth or {}, guidance or {}
        values = {}
        for number, component in enumerate(COMPONENTS):
            if component not in self.info.provides:
                continue
            truth = truths[component].numpy()
            unit = float(truth.sum() / max(3 * int((truth.sum(-1) > 0).sum()), 1))
            samples = []
            for row, (image, mask) in enumerate(zip(observations.images, observations.masks, strict=True)):
                sample = self._spoiled(component, [seed, row, number], truth[row], unit, image, mask.numpy()[..., None])
                if component in guidance and self.guidance_strength:
                    even = unit**2 * (self.noise**2 + self.inconsistency**2)
                    variance = torch.from_numpy((even + (self.scale * truth[row]) ** 2).astype(np.float32))
                    gain = variance * self.guidance_strength / (1 + variance * self.guidance_strength)
                    sample = sample + gain * (mask > 0)[..., None] * (guidance[component][row] - sample)
                samples.append(sample)
            values[component] = torch.stack(samples)
        return Samples(values)

    def _spoiled(
        self, component: str, seed: list[int], truth: np.ndarray, unit: float, image: Tensor, coverage: np.ndarray
    ) -> Tensor:
        """One image's unguided sample; ``unit``: mean of the component over all images."""
        random = np.random.default_rng(seed)
        spoiled = truth * math.exp(self.scale * random.standard_normal())
        random.standard_normal()  # of a dial that is gone: the draws that follow are those of published rows
        if component == "albedo" and self.baked:
            luminance = image.numpy() @ np.array([0.2126, 0.7152, 0.0722], np.float32)
            mean = luminance.sum() / max(float(coverage.sum()), 1e-12)
            if mean > 0:
                spoiled = spoiled * (np.maximum(luminance, 1e-6 * mean) / mean)[..., None] ** self.baked
        if self.inconsistency:
            field = gaussian_filter(random.standard_normal(truth.shape), (self.patch, self.patch, 0))  # smooth
            field = (field - field.mean()) / max(float(field.std()), 1e-12)
            spoiled = spoiled + coverage * unit * self.inconsistency * field
        if self.noise:
            spoiled = spoiled + coverage * unit * self.noise * random.standard_normal(truth.shape)
        limit = coverage if component == "albedo" else np.inf  # a sample keeps to the physical range
        return torch.from_numpy(np.clip(spoiled, 0, limit).astype(np.float32))
