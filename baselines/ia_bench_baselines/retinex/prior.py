"""Colour Retinex (Land and McCann 1971; in colour as Grosse et al. 2009): steep changes are paint, slow ones are light.

Log brightness changes from a pixel to its neighbour by the change of paint where that change, or the change of chromaticity, is
steep, and by the change of light elsewhere. The log reflectance r is what has these changes of paint, in the least squares:

    r = argmin sum over neighbours (r_p - r_q - g_pq)^2,   g_pq = b_p - b_q where |b_p - b_q| > T_b or |c_p - c_q| > T_c, else 0

with log brightness b = mean of log I over channels and chromaticity c = log I - b. The albedo is exp(r + c): Retinex asks for a
grey light. Its scale is anybody's guess.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from scipy.sparse import coo_matrix, eye_array
from scipy.sparse.linalg import spsolve
from torch import Tensor

from ia_bench.common.ranges import Positive
from ia_bench.priors.contract import Observations, PriorInfo, Samples

DARK = 1e-3  # of an image's mean radiance: no logarithm is taken below it
ANCHOR = 1e-6  # pull of r toward 0, which fixes the level of every connected piece


class RetinexPrior:
    """Deterministic: one albedo an image, without specular shading.

    ``brightness``: T_b, change of log brightness from pixel to pixel above which it is paint. ``colour``: T_c, the same of the
    chromaticity. ``mean_albedo``: what the object is assumed to have on average; the image cannot tell.
    """

    info = PriorInfo(provides=frozenset({"albedo"}))

    def __init__(self, *, brightness: Positive = 0.3, colour: Positive = 0.1, mean_albedo: Positive = 0.4) -> None:
        self.brightness, self.colour, self.mean_albedo = brightness, colour, mean_albedo

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """Albedo (V, H, W, 3) of images (V, H, W, 3), premultiplied by masks (V, H, W). Nothing is random or guided."""
        pairs = zip(observations.images.double().numpy(), observations.masks.double().numpy(), strict=True)
        albedo = np.stack([self._albedo(image, mask) for image, mask in pairs]).astype(np.float32)
        return Samples({"albedo": torch.from_numpy(albedo)})

    def _albedo(self, image: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Of one image: (H, W, 3) and (H, W) to (H, W, 3), 0 outside the mask."""
        inside = mask > 0
        result = np.zeros_like(image)
        if not inside.any():
            return result
        radiance = image[inside] / mask[inside][:, None]
        logarithm = np.log(np.maximum(radiance, DARK * max(radiance.mean(), 1e-12)))
        brightness = logarithm.mean(-1)
        chromaticity = logarithm - brightness[:, None]
        reflectance = np.exp(self._reflectance(brightness, chromaticity, inside)[:, None] + chromaticity)
        scaled = reflectance * (self.mean_albedo / reflectance.mean())
        result[inside] = np.minimum(scaled, 1) * mask[inside][:, None]
        return result

    def _reflectance(self, brightness: np.ndarray, chromaticity: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Log reflectance (N,) of the N pixels inside."""
        number = np.full(inside.shape, -1)
        number[inside] = np.arange(len(brightness))
        sides = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
        first, second = (np.concatenate([side[place].ravel() for side in sides]) for place in (0, 1))
        there = (first >= 0) & (second >= 0)
        first, second = first[there], second[there]

        change = brightness[first] - brightness[second]
        steep = np.abs(change) > self.brightness
        steep |= np.linalg.norm(chromaticity[first] - chromaticity[second], axis=-1) > self.colour
        paint = np.where(steep, change, 0.0)

        pairs, count = np.arange(len(first)), len(brightness)
        places = (np.concatenate([pairs, pairs]), np.concatenate([first, second]))
        values = np.concatenate([np.ones(len(first)), -np.ones(len(first))])
        difference = coo_matrix((values, places), shape=(len(first), count)).tocsr()
        solved: np.ndarray = spsolve((difference.T @ difference + ANCHOR * eye_array(count)).tocsc(), difference.T @ paint)
        return solved
