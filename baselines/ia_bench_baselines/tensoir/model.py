"""What TensoIR trains: the tensor, its two heads, and the light."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample, interpolate

from ia_bench.material.brdf import normalize
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.networks import encoded, initialise, perceptron, positional_encoding
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, fibonacci_axes, lobe_integral
from ia_bench_baselines.common.spherical_gaussians.sampling import Directions
from ia_bench_baselines.tensoir.method import TensoirOptions

PLANES = ((0, 1), (0, 2), (1, 2))  # the axes of each plane ...
LINES = (2, 1, 0)  # ... and of the line that it is multiplied by
START = 0.1  # standard deviation of all values at the start


class VectorMatrix(nn.Module):
    """Features of points in [-1, 1]^3, each the product of a plane's value and a line's: 3 R of them.

    It is refined once. The fine tensor is the coarse one, interpolated and from then on held, plus what is trained, which starts
    at 0: the same as training interpolated values.
    """

    def __init__(self, components: int, coarse: int, fine: int, generator: torch.Generator) -> None:
        """``components`` (R) of each of the three pairs; ``coarse`` and ``fine`` cells along a side."""
        super().__init__()
        device = generator.device

        def drawn(*shape: int) -> nn.Parameter:
            return nn.Parameter(START * torch.randn(shape, generator=generator, device=device))

        self.coarse_planes, self.coarse_lines = drawn(3, components, coarse, coarse), drawn(3, components, coarse, 1)
        self.fine_planes = nn.Parameter(torch.zeros(3, components, fine, fine, device=device))
        self.fine_lines = nn.Parameter(torch.zeros(3, components, fine, 1, device=device))
        self._held: tuple[Tensor, Tensor] | None = None

    def coarse(self) -> list[nn.Parameter]:
        """What is trained before :meth:`refine`."""
        return [self.coarse_planes, self.coarse_lines]

    def fine(self) -> list[nn.Parameter]:
        """What is trained after it."""
        return [self.fine_planes, self.fine_lines]

    def refine(self) -> None:
        """Go on with the fine tensor."""
        pairs = (self.coarse_planes, self.fine_planes), (self.coarse_lines, self.fine_lines)
        planes, lines = (
            interpolate(coarse.detach(), list(fine.shape[2:]), mode="bilinear", align_corners=True) for coarse, fine in pairs
        )
        self._held = planes, lines

    def values(self) -> tuple[Tensor, Tensor]:
        """Planes (3, R, G, G), whose columns belong to the first of their axes, and lines (3, R, G, 1), as they are now."""
        if self._held is None:
            return self.coarse_planes, self.coarse_lines
        return self._held[0] + self.fine_planes, self._held[1] + self.fine_lines

    def forward(self, position: Tensor) -> Tensor:
        """Features (N, 3 R) at positions (N, 3); beyond the cube its border is repeated."""
        planes, lines = self.values()
        across = torch.stack([position[:, axes] for axes in PLANES])[:, :, None]  # (3, N, 1, 2)
        along = torch.stack([position[:, axis] for axis in LINES])[:, :, None]
        along = torch.stack([torch.zeros_like(along), along], -1)
        found = _looked_up(planes, across) * _looked_up(lines, along)  # (3, R, N, 1)
        return found[..., 0].flatten(0, 1).T

    def variation(self) -> Tensor:
        """Twice the mean squared difference between neighbouring values, summed over planes and lines and their axes."""
        planes, lines = self.values()
        steps = planes.diff(dim=2), planes.diff(dim=3), lines.diff(dim=2)
        return 2 * torch.stack([step.square().mean() for step in steps]).sum()


def _looked_up(grid: Tensor, place: Tensor) -> Tensor:
    return grid_sample(grid, place, mode="bilinear", padding_mode="border", align_corners=True)


FEATURES, HIDDEN, FREQUENCIES = 27, 128, 2  # after the basis; of a head's layers; of every encoding
ROUGHNESS = (0.09, 0.9)  # the least one, and the range above it
FLATTEST = 1e-3  # of the box's longest side, which every other has at least
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
        low, high = corners
        self.register_buffer("low", low)
        self.register_buffer("high", torch.maximum(high, low + FLATTEST * (high - low).max()))

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


def arriving_light(stage: Stage, points: SurfacePoints, drawn: Directions, reflections: Tensoir | None) -> Tensor:
    """Radiance (N, D, 3) along the drawn directions, through which gradients flow to the light alone.

    ``reflections``: the model whose radiance head tells what other parts of the object send; None for nothing, as under a light
    that the head was not trained with.
    """
    above = drawn.weight > 0
    face, barycentric, _ = stage.rays.intersect(stage.surface.lifted(points), drawn.direction.contiguous(), above)
    light = torch.where((above & (face < 0))[..., None], drawn.radiance, 0)
    if reflections is None:
        return light
    point, which = torch.nonzero(face >= 0, as_tuple=True)
    with torch.no_grad():
        normal, position = stage.surface.geometry(face[point, which], barycentric[point, which])
        away = -drawn.direction[point, which]
        sent = reflections.radiance(reflections.features(reflections.local(position)), away)
        sent = sent * ((normal * away).sum(1, keepdim=True) > 0)  # the back of a triangle sends nothing
    return light.index_put((point, which), sent)
