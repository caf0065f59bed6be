"""What TensoIR trains: the tensor, its two heads, and the light."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ia_bench.material.brdf import normalize
from ia_bench_baselines.common.networks import encoded, initialise, perceptron, positional_encoding
from ia_bench_baselines.common.spherical_gaussians.environment import fibonacci_axes
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, lobe_integral
from ia_bench_baselines.tensoir.settings import TensoirOptions
from ia_bench_baselines.tensoir.tensor import VectorMatrix

FEATURES, HIDDEN, FREQUENCIES = 27, 128, 2  # after the basis; of a head's layers; of every encoding
ROUGHNESS = (0.09, 0.9)  # the least one, and the range above it
FIRST_SHARPNESS, SPREAD = 10.0, 20.0  # of the light: lambda = 10 + 20 |N(0, 1)|
FIRST_ENERGY = 0.8 * 2 * math.pi  # of the whole light at the start, each channel


class Tensoir(nn.Module):
    """Everything that is trained. Positions are taken relative to the ``low`` and ``high`` corner of the object's box."""

    low: Tensor
    high: Tensor

    def __init__(self, options: TensoirOptions, corners: Tensor, generator: torch.Generator) -> None:
        """``corners`` (2, 3) of the bounding box."""
        super().__init__()
        self.tensor = VectorMatrix(options.components, options.coarse, options.fine, generator)
        self.basis = nn.Linear(3 * options.components, FEATURES, bias=False)
        inputs = encoded(FEATURES, FREQUENCIES) + encoded(3, FREQUENCIES)
        self.radiance_head = perceptron([inputs, HIDDEN, HIDDEN, 3])
        self.material_head = perceptron([inputs, HIDDEN, HIDDEN, 4])
        for network in (self.basis, self.radiance_head, self.material_head):
            initialise(network.to(corners.device), generator)
        self.light = TrainedLight(options.lobes, generator)
        self.register_buffer("low", corners[0])
        self.register_buffer("high", corners[1])

    def local(self, position: Tensor) -> Tensor:
        """Positions in the cube [-1, 1]^3."""
        return 2 * (position - self.low) / (self.high - self.low) - 1

    def features(self, local: Tensor) -> Tensor:
        """What both heads see of local positions (N, 3)."""
        return positional_encoding(self.basis(self.tensor(local)), FREQUENCIES)

    def radiance(self, features: Tensor, view: Tensor) -> Tensor:
        """Linear radiance (N, 3), at most 1, toward unit ``view`` (N, 3)."""
        return torch.sigmoid(self.radiance_head(torch.cat([features, positional_encoding(view, FREQUENCIES)], 1)))

    def material(self, features: Tensor, local: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (N, 3) and roughness (N, 1)."""
        found = torch.sigmoid(self.material_head(torch.cat([features, positional_encoding(local, FREQUENCIES)], 1)))
        return found[:, :3], ROUGHNESS[0] + ROUGHNESS[1] * found[:, 3:]

    def networks(self) -> list[nn.Parameter]:
        """Basis and heads."""
        return [p for part in (self.basis, self.radiance_head, self.material_head) for p in part.parameters()]


class TrainedLight(nn.Module):
    """Spherical Gaussians whose axes, and logarithms of sharpness and amplitude, are trained."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        """White light, its lobes on two copies of a sphere of evenly spread axes, all of the same energy."""
        super().__init__()
        device = generator.device
        axes = fibonacci_axes(-(-count // 2)).repeat(2, 1)[:count].to(device)
        sharpness = FIRST_SHARPNESS + SPREAD * torch.randn(count, generator=generator, device=device).abs()
        amplitude = FIRST_ENERGY / count / lobe_integral(sharpness)
        self.axis = nn.Parameter(axes)
        self.log_sharpness = nn.Parameter(sharpness.log())
        self.log_amplitude = nn.Parameter(amplitude.log()[:, None].repeat(1, 3))

    def lobes(self) -> SphericalGaussians:
        """The light as it is now."""
        return SphericalGaussians(normalize(self.axis), self.log_sharpness.exp(), self.log_amplitude.exp())
