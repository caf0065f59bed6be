"""What InvRender recovered, shaded by its own spherical Gaussians under its own light and under others."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material, fetch
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality
from ia_bench.render.stage import Stage
from ia_bench_baselines.common.shaded import ShadedReconstruction, Shader
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

    def shader(given: Environment | None, quality: Quality) -> Shader:
        lobes, around = (light, indirect) if given is None else (fit_light(given), None)
        visibility = LobeVisibility(stage.apart, torch.Generator(device=stage.device).manual_seed(quality.seed))

        def radiance(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
            albedo, roughness = fetch(material.albedo, points.uv), fetch(material.roughness, points.uv)
            scaled = albedo if albedo_scale is None else albedo * albedo_scale.to(albedo)
            return shade(points, scaled, roughness, lobes, visibility, None if around is None else around.at(points.uv))

        return radiance

    environment = SphericalGaussianEnvironment(light)
    return ShadedReconstruction(
        stage, material, renderer="spherical Gaussians", environment=environment, shader=shader, at_once=SHADED_AT_ONCE
    )
