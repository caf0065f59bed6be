"""The fit of nvdiffrecmc on a shared mesh, and what it recovers."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.light.environment import Environment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS, normalize
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.descent import Descent, Phase
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.renderer import PixelRadiance
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import tone_map
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.textured import TexturedScene
from ia_bench_baselines.nvdiffrecmc.denoiser import Guides, denoise
from ia_bench_baselines.nvdiffrecmc.method import NvdiffrecmcOptions


class DirectReconstruction(TexturedReconstruction):
    """Textures and a light with traced shadows and without interreflection.

    Under a light that it was not fitted with it renders nothing, so that its textures are relit by the reference renderer, as the
    paper does.
    """

    def __init__(self, stage: Stage, material: Material, light: Tensor) -> None:
        """``light`` (H, W, 3) radiance."""
        super().__init__(stage, material, light, coat="added", bounces=0)

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.render`."""
        return None if light is not None else super().render(cameras, light=None, albedo_scale=albedo_scale, quality=quality)


LEAST = 0.01  # of the base colour, and of what is no metal: light is demodulated by their product
LUMA = (0.2126, 0.7152, 0.0722)  # Y of linear Rec.709


class Fit:
    """State of one fit of :class:`ia_bench_baselines.nvdiffrecmc.method.Nvdiffrecmc`."""

    def __init__(self, problem: Problem, options: NvdiffrecmcOptions, *, seed: int, monitor: Monitor) -> None:
        self._problem, self._options, self._seed = problem, options, seed
        with problem.costs.exclude("bake"):
            self._pixels = TrainingPixels(problem, problem.plan.subsamples)
            self._each = problem.plan.subsamples**2
            self._views = [torch.nonzero(self._pixels.view == view)[:, 0] for view in range(len(problem.scene.train))]
            self._views = [pixels for pixels in self._views if len(pixels)]
            self._renderer = problem.stage.renderer(shadows="traced", bounces=0, coat="added")
            self._scene = TexturedScene(
                problem,
                self._pixels,
                roughness=options.roughness_initial,
                metallic=options.metallic_initial,
                least=LEAST,
                least_roughness=MIN_ROUGHNESS,
            )
        phase = Phase(
            "fit",
            options.steps,
            self._loss,
            lambda: self._scene.optimizer(material=options.material_rate, light=options.light_rate),
            rate=lambda share: options.final_rate**share,
            project=self._scene.project,
        )
        self._descent = Descent(self._scene, [phase], seed=seed, monitor=monitor, start=self._start)

    def finish(self) -> Result:
        """Take the remaining steps and return what was recovered."""
        return self._descent.run(self._recovered)

    @torch.no_grad()
    def _start(self) -> None:
        """Images are linear in the light: begin with the even, grey one under which the object is as bright as they are."""
        generator = torch.Generator(device=self._problem.device).manual_seed(derive_seed(self._seed, "start"))
        some = self._pixels.draw(4096, generator)
        unlit = self._render(some, self._scene.light, generator).radiance.mean()
        self._scene.log_light.add_(torch.log(self._pixels.radiance.mean().clamp_min(1e-8) / unlit.clamp_min(1e-8)))

    def _loss(self, step: int, generator: torch.Generator) -> Tensor:
        options, scene = self._options, self._scene
        chosen = self._views[int(torch.randint(len(self._views), (), generator=generator, device=generator.device))]
        points = self._pixels.points(chosen)
        rendered = self._render(chosen, scene.light, generator)

        # ---- what reaches the surface, without its colour, and without noise ------------------------------------
        colour = self._mean(self._diffuse_colour(points.uv))
        demodulated = torch.cat([rendered.diffuse / colour, rendered.specular], -1)
        sigma = options.denoiser_width * min(1.0, (step + 1) / max(options.denoiser_steps, 1))
        matt, glossy = denoise(demodulated, self._guides(chosen, points), sigma).split(3, -1)

        # ---- image and regularisers -----------------------------------------------------------------------------
        seen = matt * colour + glossy
        target = self._pixels.target(chosen, seen)
        image = (tone_map(seen.clamp_min(0)) - tone_map(target)).abs().mean()
        brightness = (matt + glossy) @ torch.tensor(LUMA, device=target.device)
        monochrome = (tone_map(brightness.clamp_min(0)) - tone_map(target.amax(-1))).abs().mean()
        change, material = scene.variation(points.uv, options.smooth_texels, generator)
        smooth = options.smooth_colour * change + options.smooth_material * material
        return image + options.monochrome_light * monochrome + smooth

    def _render(self, pixels: Tensor, light: Tensor, generator: torch.Generator) -> PixelRadiance:
        sampled = SampledLight.of(light, uniform_fraction=self._options.defensive_share)
        entries = self._pixels.entries[pixels]
        return self._renderer.render_pixels(
            self._pixels.gbuffer, entries, self._scene.material(), sampled, self._options.samples, generator
        )

    def _diffuse_colour(self, uv: Tensor) -> Tensor:
        """k_d (1 - m) of points at ``uv`` (N, 2), looked up as the renderer does."""
        albedo, _, metallic = self._scene.at(uv)
        return albedo * (1 - metallic)

    def _mean(self, values: Tensor) -> Tensor:
        """The means (N, C) over the points of N pixels of what each point has, (N S, C), as the renderer has radiance."""
        return values.unflatten(0, (-1, self._each)).mean(1)

    def _guides(self, pixels: Tensor, points: SurfacePoints) -> Guides:
        """The mean normal of each pixel's points, and how far their mean position is from the camera."""
        buffer, entries = self._pixels.gbuffer, self._pixels.entries[pixels]
        _, height, width = buffer.shape
        place = buffer.pixel[entries] % (height * width)
        depth = (self._mean(points.position) - buffer.seen_from(entries)).norm(dim=-1, keepdim=True)
        return Guides(place // width, place % width, normalize(self._mean(points.normal)), depth, (height, width))

    def _recovered(self) -> DirectReconstruction:
        return DirectReconstruction(self._problem.stage, self._scene.recovered(), self._scene.light.detach())
