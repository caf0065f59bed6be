"""What InvRender fits, and how it shades."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ia_bench.material.brdf import normalize
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Mesh
from ia_bench_baselines.common.networks import encoded, initialise, perceptron, positional_encoding
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, fibonacci_axes
from ia_bench_baselines.common.spherical_gaussians.sampling import directions_of_lobes
from ia_bench_baselines.common.spherical_gaussians.shading import Gloss, glossy, irradiance, reflected_lobe

RAYS_OF_REFLECTION = 4
WIDEST, NARROWEST = 0.1, 50.0  # sharpness of a reflected lobe whose visibility is asked for


class LobeVisibility:
    """Visibility of lobes, V(x) = the mean of v(x, w) over directions w in proportion to the lobe, estimated by a few rays.

    The original asks a network for v in 32 directions around every lobe, nearer to its axis than in proportion to it, see the
    card. One ray a lobe has V as its mean over the steps of a fit and the points of a picture. What is below the horizon of the
    point's triangle is not seen. No gradient passes.
    """

    def __init__(self, stage: Stage, generator: torch.Generator) -> None:
        """``generator``: draws the directions."""
        self._stage, self._generator = stage, generator

    @torch.no_grad()
    def of_light(self, points: SurfacePoints, axis: Tensor, sharpness: Tensor) -> Tensor:
        """Of M lobes that are the same for all N points, (M, 3) and (M,): (N, M) of 0 and 1, one ray each."""
        shape = len(points.position), *sharpness.shape
        return self._free(points, directions_of_lobes(axis.expand(*shape, 3), sharpness.expand(shape), self._generator))

    @torch.no_grad()
    def of_reflection(self, points: SurfacePoints, axis: Tensor, sharpness: Tensor) -> Tensor:
        """Of one reflected lobe of each point, (N, 3) and (N, 1): (N, 1), the mean of RAYS_OF_REFLECTION rays."""
        shape = len(axis), RAYS_OF_REFLECTION
        wide = sharpness.clamp(WIDEST, NARROWEST).expand(shape)
        return self._free(points, directions_of_lobes(axis[:, None].expand(*shape, 3), wide, self._generator)).mean(1, keepdim=True)

    def _free(self, points: SurfacePoints, directions: Tensor) -> Tensor:
        above = (directions @ points.geometric[:, :, None])[..., 0] > 0
        return (above & ~self._stage.rays.occluded(self._stage.surface.lifted(points), directions, above)).float()


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
        wanted = 4 * math.pi * max(radiance, 1e-8) / (albedo * SEEN_OF_SKY)
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
