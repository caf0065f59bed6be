"""The fit of nvdiffrec on a shared mesh, and what it recovers."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.material.textures import Material, fetch
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.descent import Descent, Phase
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality
from ia_bench.scenes.color import tone_map
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.shaded import ShadedReconstruction, Shader
from ia_bench_baselines.common.textured import TexturedScene
from ia_bench_baselines.nvdiffrec.method import NvdiffrecOptions
from ia_bench_baselines.nvdiffrec.prefilter import PrefilteredLight
from ia_bench_baselines.nvdiffrec.split_sum import shade

LEAST_ROUGHNESS = 0.08  # below it a lobe is narrower than the texels of the light


def fit(problem: Problem, options: NvdiffrecOptions, *, seed: int, monitor: Monitor) -> Result:
    """See :class:`ia_bench_baselines.nvdiffrec.method.Nvdiffrec`."""
    side = problem.plan.subsamples
    with problem.costs.exclude("bake"):
        pixels = TrainingPixels(problem, side)
        scene = TexturedScene(
            problem,
            pixels,
            roughness=options.roughness_initial,
            metallic=options.metallic_initial,
            least=0.0,
            least_roughness=LEAST_ROUGHNESS,
        )

    @torch.no_grad()
    def start() -> None:
        """Images are linear in the light: begin with the even, grey one under which the object is as bright as they are."""
        some = pixels.draw(options.pixels, torch.Generator(device=problem.device).manual_seed(derive_seed(seed, "start")))
        unlit = _radiance(scene.textures(), PrefilteredLight(scene.light), pixels.points(some))
        scene.log_light.add_(torch.log(pixels.radiance.mean().clamp_min(1e-8) / unlit.mean().clamp_min(1e-8)))

    def loss(step: int, generator: torch.Generator) -> Tensor:
        chosen = pixels.draw(options.pixels, generator)
        points, light = pixels.points(chosen), scene.light
        seen = _radiance(scene.textures(), PrefilteredLight(light), points).unflatten(0, (-1, side * side)).mean(1)
        image = (tone_map(seen.clamp_min(0)) - tone_map(pixels.target(chosen, seen))).abs().mean()
        colour, material = scene.variation(points.uv, options.smooth_texels, generator)
        grey = (light - light.mean(-1, keepdim=True)).abs().mean()
        return image + options.smooth_colour * colour + options.smooth_material * material + options.grey_light * grey

    def recovered() -> ShadedReconstruction:
        return reconstruction(problem, scene.recovered(), scene.light.detach())

    phase = Phase(
        "fit",
        options.steps,
        loss,
        lambda: scene.optimizer(material=options.material_rate, light=options.light_rate),
        rate=lambda share: options.final_rate**share,
        project=scene.project,
    )
    return Descent(scene, [phase], seed=seed, monitor=monitor, start=start).run(recovered)


def _radiance(textures: Tensor, light: PrefilteredLight, points: SurfacePoints) -> Tensor:
    values = fetch(textures, points.uv)
    return shade(light, points.normal, points.view, values[:, :3], values[:, 3:4], values[:, 4:])


def reconstruction(problem: Problem, material: Material, light: Tensor) -> ShadedReconstruction:
    """Textures and a light (H, 2 H, 3), which split sums draw under that light and under no other."""
    assert material.metallic is not None
    textures = torch.cat([material.albedo, material.roughness, material.metallic], -1)

    def shader(novel: Environment | None, quality: Quality) -> Shader | None:
        if novel is not None:
            return None
        prefiltered = PrefilteredLight(light)

        def radiance(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
            if albedo_scale is None:
                return _radiance(textures, prefiltered, points)
            scale = torch.cat([albedo_scale.to(textures), textures.new_ones(2)])
            return _radiance(textures * scale, prefiltered, points)

        return radiance

    return ShadedReconstruction(
        problem.stage,
        material,
        renderer="split sum",
        environment=LatLongEnvironment(light),
        shader=shader,
        light_rows=len(light),
    )
