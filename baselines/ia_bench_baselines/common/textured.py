"""What nvdiffrec and nvdiffrecmc optimise: textures of base colour, roughness and metal, and a map of log radiance."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ia_bench.material.textures import Material, fetch, fill_unobserved, splat
from ia_bench.methods.contract import Problem
from ia_bench_baselines.common.pixels import TrainingPixels


class TexturedScene(nn.Module):
    """Textures over the mesh's UV and a lat-long light.

    Attributes:
        base_colour: (T, T, 3) in [least, 1], linear.
        roughness: (T, T, 1) in [least_roughness, 1], perceptual.
        metallic: (T, T, 1) in [0, 1 - least].
        log_light: (H, 2 H, 3), logarithm of the light's radiance.
        observed: (T, T) bool, the texels that some training pixel shows; those seen on edges alone are not among them.
    """

    base_colour: nn.Parameter
    observed: Tensor

    def __init__(
        self, problem: Problem, pixels: TrainingPixels, *, roughness: float, metallic: float, least: float, least_roughness: float
    ) -> None:
        """All textures start constant: the base colour at .5, the others as near as they may be; the light at radiance 1."""
        super().__init__()
        plan, device = problem.plan, problem.device
        size, rows = plan.texture, plan.light_height
        self.base_colour = nn.Parameter(torch.full((size, size, 3), 0.5, device=device))
        self.roughness = nn.Parameter(torch.full((size, size, 1), roughness, device=device))
        self.metallic = nn.Parameter(torch.full((size, size, 1), metallic, device=device))
        self.log_light = nn.Parameter(torch.zeros(rows, 2 * rows, 3, device=device))
        trained = pixels.gbuffer.at(pixels.entries)
        uv = problem.stage.surface.uv(trained.face.reshape(-1).long(), trained.barycentric.reshape(-1, 2))
        self.register_buffer("observed", splat(uv, torch.zeros(len(uv), 0, device=device), size)[1] > 0)
        self._least, self._least_roughness = least, least_roughness
        with torch.no_grad():
            self.project()

    @property
    def light(self) -> Tensor:
        """Radiance of the light, (H, 2 H, 3)."""
        return torch.exp(self.log_light)

    def material(self) -> Material:
        """The textures as they are, through which gradients flow."""
        return Material(self.base_colour, self.roughness, self.metallic)

    def textures(self) -> Tensor:
        """Base colour, roughness and metal as one texture (T, T, 5)."""
        return torch.cat([self.base_colour, self.roughness, self.metallic], -1)

    def at(self, uv: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Base colour (N, 3), roughness and metal (N, 1) at ``uv`` (N, 2)."""
        colour, roughness, metallic = fetch(self.textures(), uv).split((3, 1, 1), -1)
        return colour, roughness, metallic

    def project(self) -> None:
        """Back to valid values, in place."""
        self.base_colour.clamp_(self._least, 1)
        self.roughness.clamp_(self._least_roughness, 1)
        self.metallic.clamp_(0, 1 - self._least)

    def variation(self, uv: Tensor, texels: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Mean change of the base colour, and of roughness and metal, from points at ``uv`` (N, 2) to points near by.

        Their distance is normal with a standard deviation of ``texels`` along u and v.
        """
        step = torch.randn(uv.shape, generator=generator, device=uv.device) * (texels / len(self.base_colour))
        textures = self.textures()
        change = (fetch(textures, uv) - fetch(textures, uv + step)).abs()
        return change[:, :3].mean(), change[:, 3:].mean()

    def recovered(self) -> Material:
        """The textures, texels that no training pixel shows filled from their neighbours."""
        parts = (self.base_colour, self.roughness, self.metallic)
        return Material(*(fill_unobserved(part.detach(), self.observed) for part in parts))

    def optimizer(self, *, material: float, light: float) -> torch.optim.Adam:
        """Adam with these rates of the textures and of the log radiance."""
        groups = [
            {"params": [self.base_colour, self.roughness, self.metallic], "lr": material},
            {"params": [self.log_light], "lr": light},
        ]
        return torch.optim.Adam(groups, betas=(0.9, 0.99), fused=True)
