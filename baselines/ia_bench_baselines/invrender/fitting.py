"""The three phases of InvRender: the radiance that leaves the object, the indirect light it makes, material and light."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.descent import Phase
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.shaded import ShadedReconstruction, bake
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians
from ia_bench_baselines.invrender.method import InvRenderOptions
from ia_bench_baselines.invrender.model import PERTURBATION, InvRenderModel, LobeVisibility, shade, sparsity
from ia_bench_baselines.invrender.reconstruction import reconstruction
from ia_bench_baselines.invrender.transport import IndirectLight, Transport

DIRECTIONS_OF_A_STEP = 32  # that indirect light is compared in; half of them are above the surface


class Fitting:
    """One scene, the model that is fitted to it, and its losses."""

    def __init__(self, problem: Problem, options: InvRenderOptions, seed: int) -> None:
        """Trace what sees what. Raises InputError where no training pixel shows the object alone."""
        self._options, self._stage = options, problem.stage
        self._pixels = TrainingPixels(problem)
        self._transport = Transport.of(problem.stage, options.atlas, options.directions)
        generator = torch.Generator().manual_seed(derive_seed(seed, "weights"))
        self.model = InvRenderModel(problem.scene.expect_mesh(), options.width, options.octaves, generator).to(problem.device)
        self.model.light_up(float(self._pixels.radiance.mean()))
        self._indirect: IndirectLight | None = None

    def phases(self) -> list[Phase]:
        """What :class:`ia_bench.methods.descent.Descent` goes through."""
        options, model = self._options, self.model

        def decay(share: float) -> float:
            return options.final_rate**share

        def adam(module: torch.nn.Module) -> torch.optim.Optimizer:
            return torch.optim.Adam(module.parameters(), lr=options.network_rate)

        def adam_of_all() -> torch.optim.Optimizer:
            light = [model.light_axis, model.light_sharpness, model.light_amplitude]
            networks = {"params": list(model.material.parameters()), "lr": options.network_rate}
            return torch.optim.Adam([networks, {"params": light, "lr": options.light_rate}])

        steps = options.radiance_steps if options.indirect_steps else 0
        return [
            Phase("radiance", steps, self._of_radiance, lambda: adam(model.radiance), rate=decay, scored=False),
            Phase(
                "indirect",
                options.indirect_steps,
                self._of_indirect,
                lambda: adam(model.indirect),
                rate=decay,
                scored=False,
            ),
            Phase(
                "material",
                options.steps,
                self._of_images,
                adam_of_all,
                rate=decay,
                begin=self._keep_indirect,
                project=model.project,
            ),
        ]

    # ---- losses ------------------------------------------------------------------------------------------------------

    def _of_radiance(self, step: int, generator: torch.Generator) -> Tensor:
        """L1 between the radiance field and the photographs, linear."""
        drawn = self._pixels.draw(self._options.pixels, generator)
        points = self._pixels.points(drawn)
        found = self.model.radiance(self.model.unit(points.position), points.normal, points.view)
        return (found - self._pixels.target(drawn, found)).abs().sum(1).mean()

    def _of_indirect(self, step: int, generator: torch.Generator) -> Tensor:
        """L1 between indirect lobes and the radiance field where a direction ends; nothing arrives where it ends nowhere."""
        traced, model = self._transport, self.model
        device = traced.directions.device
        texel = torch.randint(len(traced.position), (self._options.texels,), generator=generator, device=device)
        which = torch.randint(len(traced.directions), (len(texel), DIRECTIONS_OF_A_STEP), generator=generator, device=device)
        directions, landed = traced.directions[which], traced.landed[texel].gather(1, which)
        hit = landed >= 0
        there = landed[hit].long()
        true = torch.zeros_like(directions)
        with torch.no_grad():
            true[hit] = model.radiance(model.unit(traced.position[there]), traced.normal[there], -directions[hit]).clamp_min(0)
        found = model.indirect(model.unit(traced.position[texel])).radiance(directions)
        above = traced.above[texel].gather(1, which)[..., None]
        return ((found - true).abs() * above).sum() / above.sum().clamp_min(1)

    def _of_images(self, step: int, generator: torch.Generator) -> Tensor:
        """L1 of the render, sparse latent codes, and a material that a small change of its code does not change."""
        material, options = self.model.material, self._options
        drawn = self._pixels.draw(options.pixels, generator)
        points = self._pixels.points(drawn)
        code = material.code(self.model.unit(points.position))
        noise = PERTURBATION * torch.randn(code.shape, generator=generator, device=code.device)
        albedo, roughness = material.decode(torch.cat([code, code + noise]))
        (albedo, near_albedo), (roughness, near_roughness) = albedo.chunk(2), roughness.chunk(2)
        visibility = LobeVisibility(self._stage, generator)
        indirect = None if self._indirect is None else self._indirect.at(points.uv)
        found = shade(points, albedo, roughness, self.model.light(), visibility, indirect)
        image = (found - self._pixels.target(drawn, found)).abs().sum(1).mean()
        change = (albedo - near_albedo).abs().mean() + (roughness - near_roughness).abs().mean()
        return image + options.sparsity * sparsity(code) + options.smoothness * change

    @torch.no_grad()
    def _keep_indirect(self, done: int) -> None:
        """Indirect light is known by now: write its lobes down for all texels."""
        if self._options.indirect_steps:
            lobes = self.model.indirect(self.model.unit(self._transport.position))
            self._indirect = IndirectLight(self._transport.atlas, lobes)

    # ---- what is recovered -------------------------------------------------------------------------------------------

    @torch.no_grad()
    def recovered(self) -> ShadedReconstruction:
        """Textures of the material, the light as it is, and the method's own shading."""
        model = self.model
        found = bake(self._stage, self._options.texture, lambda position: model.material(model.unit(position)))
        material = Material(found[..., :3].contiguous(), found[..., 3:].contiguous())
        light = SphericalGaussians(*(part.detach().clone() for part in model.light()))
        return reconstruction(self._stage, material, light, self._indirect)
