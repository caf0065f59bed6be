"""What InvRender recovered, shaded by its own spherical Gaussians under its own light and under others."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material, fetch
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.shaded import ShadedReconstruction, part_of
from ia_bench_baselines.common.spherical_gaussians.fit import fit_light
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussianEnvironment, SphericalGaussians
from ia_bench_baselines.invrender.model import LobeVisibility, shade
from ia_bench_baselines.invrender.transport import IndirectLight

SHADED_AT_ONCE = 1024  # points, whose lobes stay in the processor's cache


def reconstruction(
    stage: Stage, material: Material, light: SphericalGaussians, indirect: IndirectLight | None
) -> ShadedReconstruction:
    """Textures under ``light`` and the ``indirect`` light that it makes, which is left out under other lights.

    Those are first fitted by spherical Gaussians.
    """

    def shader(given: Environment | None, quality: Quality) -> _Shader:
        if given is None:
            return _Shader(stage, material, light, indirect, quality.seed)
        return _Shader(stage, material, fit_light(given), None, quality.seed)

    environment = SphericalGaussianEnvironment(light)
    return ShadedReconstruction(stage, material, renderer="spherical Gaussians", environment=environment, shader=shader)


class _Shader:
    """See :class:`ia_bench_baselines.common.shaded.Shader`."""

    def __init__(
        self, stage: Stage, material: Material, light: SphericalGaussians, indirect: IndirectLight | None, seed: int
    ) -> None:
        self._material, self._light, self._indirect = material, light, indirect
        self._visibility = LobeVisibility(stage.apart, torch.Generator(device=stage.device).manual_seed(seed))

    def __call__(self, points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
        shaded = []
        for part in torch.arange(len(points.uv), device=points.uv.device).split(SHADED_AT_ONCE):
            some = part_of(points, part)
            albedo, roughness = fetch(self._material.albedo, some.uv), fetch(self._material.roughness, some.uv)
            scaled = albedo if albedo_scale is None else albedo * albedo_scale.to(albedo)
            indirect = None if self._indirect is None else self._indirect.at(some.uv)
            shaded.append(shade(some, scaled, roughness, self._light, self._visibility, indirect))
        return torch.cat(shaded)
