"""Albedo and highlights of single images by two classical assumptions: grey world and Retinex."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations, PriorInfo, Samples

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear Rec.709
FLOOR = 1e-6  # keeps quotients and logarithms finite in the dark


class GreyWorldPrior:
    """Deterministic: specular = what stands out of its surroundings, albedo = the rest without light and slow shading.

    ``shading_scale``: standard deviation of the blur that counts as shading, as a fraction of the image's longer side.
    ``highlight``: how many times brighter than its surroundings a pixel is before the excess counts as specular.
    ``mean_albedo``: luminance that the object is assumed to have on average; the image cannot tell.
    """

    info = PriorInfo(provides=frozenset({"albedo", "specular"}))

    def __init__(self, *, shading_scale: float = 0.15, highlight: float = 1.6, mean_albedo: float = 0.4) -> None:
        for name, value in (("shading_scale", shading_scale), ("highlight", highlight), ("mean_albedo", mean_albedo)):
            if not value > 0:
                raise InputError(f"prior.options.{name}: expected a number > 0, found {value}")
        self.shading_scale, self.highlight, self.mean_albedo = shading_scale, highlight, mean_albedo

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """Albedo and specular radiance (V, H, W, 3) of images (V, H, W, 3), premultiplied by masks (V, H, W).

        ``seed`` and ``guidance`` change nothing.
        """
        images, masks = observations.images, observations.masks
        coverage = masks[..., None]
        radiance = torch.where(coverage > 0, images / coverage.clamp_min(FLOOR), 0.0)

        # Highlights: the excess over a multiple of the surroundings' brightness, in the colour of the light.
        light = self._mean(radiance, coverage)
        light = light / self._luminance(light).clamp_min(FLOOR)
        brightness = self._luminance(radiance)
        surroundings = self._blur(brightness, coverage)
        excess = (brightness - self.highlight * surroundings).clamp_min(0)
        specular = torch.minimum(excess * light, radiance)

        # Albedo: what is left, seen under white light and without slow changes of brightness.
        diffuse = (radiance - specular) / light.clamp_min(0.05)
        shading = self._blur(self._luminance(diffuse), coverage)
        flat = diffuse / shading.clamp_min(FLOOR)
        flat = flat * (self.mean_albedo / self._mean(self._luminance(flat), coverage).clamp_min(FLOOR))
        return Samples({"albedo": coverage * flat.clamp(0, 1), "specular": coverage * specular})

    @staticmethod
    def _luminance(colour: Tensor) -> Tensor:
        """Of linear Rec.709: (..., 3) -> (..., 1)."""
        return (colour * colour.new_tensor(LUMINANCE)).sum(-1, keepdim=True)

    @staticmethod
    def _mean(values: Tensor, coverage: Tensor) -> Tensor:
        """Mean over the mask of each image: (V, H, W, C) -> (V, 1, 1, C)."""
        return (values * coverage).sum((1, 2), keepdim=True) / coverage.sum((1, 2), keepdim=True).clamp_min(FLOOR)

    def _blur(self, values: Tensor, coverage: Tensor) -> Tensor:
        """Gaussian mean over the neighbouring pixels inside the mask: (V, H, W, 1)."""
        height, width = values.shape[1:3]
        sigma = self.shading_scale * max(height, width)
        pair = torch.cat([values * coverage, coverage], -1)
        for axis, size in ((1, height), (2, width)):
            place = torch.arange(size, dtype=values.dtype, device=values.device)
            kernel = torch.exp(-0.5 * ((place[:, None] - place) / sigma) ** 2)
            pair = torch.tensordot(pair.movedim(axis, -1), kernel, 1).movedim(-1, axis)
        return pair[..., :1] / pair[..., 1:].clamp_min(FLOOR)
