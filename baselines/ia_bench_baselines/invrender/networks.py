"""The networks of InvRender: a sparse latent material, the radiance that leaves the surface, and what arrives from it.

Positions are in [-1, 1]. PE k is a positional encoding of k octaves.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ia_bench_baselines.common.networks import encoded, perceptron, positional_encoding
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians

VIEW_OCTAVES = 4
LATENT, ACTIVE, PERTURBATION = 32, 0.05, 0.01  # codes, the share of them that is to be active, the noise that they must bear
DECODER_WIDTH = 128
ROUGHNESS_RANGE, ROUGHNESS_LEAST = 0.9, 0.09
INDIRECT_LOBES, INDIRECT_SHARPNESS, INDIRECT_LEAST = 24, 30.0, 0.1


class SparseMaterial(nn.Module):
    """Position -> PE ``octaves`` -> latent code in [0, 1]^32 -> albedo and roughness."""

    def __init__(self, width: int, octaves: int) -> None:
        super().__init__()
        self._octaves = octaves
        self.encoder = perceptron([encoded(3, octaves), width, width, width, width, LATENT], lambda: nn.LeakyReLU(0.2))
        self.decoder = perceptron([LATENT, DECODER_WIDTH, DECODER_WIDTH, 4], lambda: nn.LeakyReLU(0.2))

    def code(self, position: Tensor) -> Tensor:
        """The latent code (N, 32)."""
        return torch.sigmoid(self.encoder(positional_encoding(position, self._octaves)))

    def decode(self, code: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (N, 3) and roughness (N, 1)."""
        values = torch.sigmoid(self.decoder(code))
        return values[:, :3], ROUGHNESS_RANGE * values[:, 3:] + ROUGHNESS_LEAST

    def forward(self, position: Tensor) -> Tensor:
        """Albedo and roughness, (N, 4)."""
        return torch.cat(self.decode(self.code(position)), 1)


def sparsity(code: Tensor) -> Tensor:
    """The divergence KL(Bernoulli(ACTIVE) || Bernoulli(mean of a code over the points)), the mean over the codes."""
    mean = code.mean(0).clamp(1e-6, 1 - 1e-6)  # beyond which a float32 has no logarithm of 1 - mean
    return (ACTIVE * torch.log(ACTIVE / mean) + (1 - ACTIVE) * torch.log((1 - ACTIVE) / (1 - mean))).mean()


class RadianceField(nn.Module):
    """Position (PE ``octaves``), normal and direction toward the eye (PE 4) -> linear radiance that leaves the surface."""

    def __init__(self, width: int, octaves: int) -> None:
        super().__init__()
        self._octaves = octaves
        inputs = encoded(3, octaves) + 3 + encoded(3, VIEW_OCTAVES)
        self.layers = perceptron([inputs, width, width, width, width, 3])

    def forward(self, position: Tensor, normal: Tensor, view: Tensor) -> Tensor:
        """Radiance (N, 3); where the fit is poor it may be negative."""
        inputs = [positional_encoding(position, self._octaves), normal, positional_encoding(view, VIEW_OCTAVES)]
        return self.layers(torch.cat(inputs, 1))


class IndirectField(nn.Module):
    """Position -> PE ``octaves`` -> 24 spherical Gaussians of the light that arrives from the object itself."""

    def __init__(self, width: int, octaves: int) -> None:
        super().__init__()
        self._octaves = octaves
        self.layers = perceptron([encoded(3, octaves), width, width, width, width, 6 * INDIRECT_LOBES])

    def forward(self, position: Tensor) -> SphericalGaussians:
        """The lobes of each of N points."""
        values = self.layers(positional_encoding(position, self._octaves)).reshape(-1, INDIRECT_LOBES, 6)
        azimuth, polar = (2 * math.pi * torch.sigmoid(values[..., :2])).unbind(-1)
        axis = torch.stack([azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()], -1)
        sharpness = INDIRECT_SHARPNESS * torch.sigmoid(values[..., 2]) + INDIRECT_LEAST
        return SphericalGaussians(axis, sharpness, torch.relu(values[..., 3:]))
