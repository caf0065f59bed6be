"""What InvRender fits, and how it shades."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ia_bench.material.brdf import normalize
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.scenes.scene import Mesh
from ia_bench_baselines.common.networks import initialise
from ia_bench_baselines.common.spherical_gaussians.environment import fibonacci_axes
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians
from ia_bench_baselines.common.spherical_gaussians.shading import Gloss, glossy, irradiance, reflected_lobe
from ia_bench_baselines.invrender.networks import IndirectField, RadianceField, SparseMaterial
from ia_bench_baselines.invrender.visibility import LobeVisibility

GLOSS = Gloss(reflectance=0.02, gain=2.0)
LOBES = 128
LEAST_SHARPNESS, LARGEST_SHARPNESS = 0.1, 2000.0  # as of a light that is given
SEEN_OF_SKY = 0.7  # the share that a point of an object sees of it, roughly: for the brightness of the first light


class InvRenderModel(nn.Module):
    """All that is fitted. ``light_*`` are the axes and the logarithms of sharpness and amplitude of 128 spherical Gaussians."""

    centre: Tensor
    extent: Tensor

    def __init__(self, mesh: Mesh, width: int, octaves: int, generator: torch.Generator) -> None:
        """Networks are drawn from ``generator``, and so is the sharpness of the first light."""
        super().__init__()
        self.material = SparseMaterial(width, octaves)
        self.radiance, self.indirect = RadianceField(width, octaves), IndirectField(width, octaves)
        initialise(self, generator, math.sqrt(6))
        initialise(self.material.decoder, generator)  # whose first albedo and roughness are then near the middle of their ranges
        low, high = (torch.from_numpy(bound) for bound in (mesh.vertices.min(0), mesh.vertices.max(0)))
        self.register_buffer("centre", (low + high) / 2)
        self.register_buffer("extent", ((high - low) / 2).max())
        half = fibonacci_axes(LOBES // 2)
        self.light_axis = nn.Parameter(torch.cat([half, half]))
        self.light_sharpness = nn.Parameter(torch.log(10 + (20 * torch.randn(LOBES, generator=generator)).abs()))
        self.light_amplitude = nn.Parameter(torch.zeros(LOBES, 3))

    @torch.no_grad()
    def light_up(self, radiance: float) -> None:
        """Start from a grey light, even but for its lobes, under which the material as it is shows this mean ``radiance``."""
        albedo = self.material(torch.zeros(1, 3, device=self.centre.device))[:, :3].mean()
        wanted = 4 * math.pi * radiance / (albedo * SEEN_OF_SKY)
        self.light_amplitude.zero_()
        self.light_amplitude.copy_(torch.log(wanted / self.light().energy().sum(0)).expand(LOBES, 3))

    def light(self) -> SphericalGaussians:
        """The direct light."""
        return SphericalGaussians(normalize(self.light_axis), self.light_sharpness.exp(), self.light_amplitude.exp())

    def project(self) -> None:
        """Hold the sharpness of the light in its range."""
        self.light_sharpness.clamp_(math.log(LEAST_SHARPNESS), math.log(LARGEST_SHARPNESS))

    def unit(self, position: Tensor) -> Tensor:
        """Positions in scene units as networks take them, in [-1, 1]."""
        return (position - self.centre) / self.extent


def shade(
    points: SurfacePoints,
    albedo: Tensor,
    roughness: Tensor,
    light: SphericalGaussians,
    visibility: LobeVisibility,
    indirect: SphericalGaussians | None,
) -> Tensor:
    """Radiance (N, 3) toward the camera.

    Every lobe of the light has a visibility of its own where it is reflected by the diffuse lobe, and all share one, that of the
    reflected lobe, where by GGX. Visibility carries no gradient. ``indirect`` are the lobes of each point, which see no shadow.
    """
    normal, view = points.normal, points.view
    axis, sharpness, _ = reflected_lobe(normal, view, roughness.detach(), GLOSS)
    arriving = irradiance(light, normal, visibility.of_light(points, light.axis.detach(), light.sharpness.detach()))
    reflected = glossy(light, normal, view, roughness, GLOSS) * visibility.of_reflection(points, axis, sharpness)
    if indirect is not None:
        arriving = arriving + irradiance(indirect, normal)
        reflected = reflected + glossy(indirect, normal, view, roughness, GLOSS)
    return albedo / math.pi * arriving + reflected
