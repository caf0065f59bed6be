"""A scene at its ground truth, ready to be rendered with some of its pixels and differentiated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from benchmarks.reference import TorchRenderer
from benchmarks.stage import true_material
from benchmarks.stiffness.gauss_newton import Jacobian
from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.plan import make_plan
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.readers.native import NativeReader
from ia_bench.render import stage as render
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import Renderer
from ia_bench.render.settings import RenderSettings
from ia_bench.scenes.color import tone_map
from ia_bench.scenes.scene import Scene

FLOOR = 1e-4  # of the mean radiance: darker texels of a true light have no useful logarithm


@dataclass(frozen=True)
class TruthOfAFit:
    """What the fit would work on, and the truth as it would represent it.

    ``log_light`` (H, W, 3) and the textures have the plan's sizes; ``floored``: texels of the light that were raised to FLOOR.
    """

    scene: Scene
    renderer: Renderer
    gbuffer: GBuffer
    material: Material
    log_light: Tensor
    samples: int
    floored: int

    @classmethod
    def at_truth(cls, folder: Path, *, samples: int | None = None, bounces: int | Literal["auto"] = "auto") -> TruthOfAFit:
        """Load a scene folder that ships true textures and its training light; sizes are those of a run's plan.

        ``samples``: per pixel, the fit's by default; ``bounces`` as render.bounces. Raises InputError where the truth is missing.
        """
        scene = NativeReader(folder).read(truth=True)
        truth, cpu = scene.truth, torch.device("cpu")
        if truth is None or truth.albedo is None or truth.roughness is None or "train" not in truth.lights:
            raise InputError(f"{folder}: stiffness is measured at the truth, and this scene ships no true textures and light")
        stage = render.Stage(scene.expect_mesh(), cpu)
        settings = RenderSettings(bounces=bounces)
        plan = make_plan(scene.blind(), stage, settings)
        renderer = TorchRenderer(stage.renderer(shadows=plan.shadows, bounces=plan.bounces, coat=settings.coat))
        gbuffer = stage.gbuffer([view.camera for view in scene.train], plan.subsamples)
        true = true_material(truth)
        albedo, roughness = (_resized(part, plan.texture) for part in (true.albedo, true.roughness))
        material = Material(albedo, roughness, None if true.metallic is None else _resized(true.metallic, plan.texture))
        radiance = LatLongEnvironment(torch.from_numpy(truth.lights["train"])).latlong(plan.light_height)
        floor = FLOOR * float(radiance.mean())
        floored = int((radiance < floor).any(-1).sum())
        log_light = torch.log(radiance.clamp_min(floor))
        return cls(scene, renderer, gbuffer, material, log_light, samples or plan.samples, floored)

    def pixels(self, count: int) -> Tensor:
        """A fixed random choice of G-buffer entries, (min(count, P),)."""
        return torch.randperm(len(self.gbuffer.pixel), generator=torch.Generator().manual_seed(0))[:count]

    def jacobian(self, pixels: Tensor, texture: int, light_rows: int, *, seed: int = 0) -> Jacobian:
        """Of the tone-mapped radiance (P, 3) of G-buffer entries, the image loss's residual but for a constant.

        With respect to changes, from none, of "albedo" (t, t, 3), "roughness" (t, t, 1) and "log_light" (h, 2 h, 3): on coarser
        grids than the fit's, one value a block of texels, where ``texture`` or ``light_rows`` is smaller than the plan's.
        """
        size, rows = self.material.albedo.shape[0], self.log_light.shape[0]
        if size % texture or rows % light_rows:
            raise InputError(f"expected divisors of the plan's {size} texels and {rows} light rows, found {texture}, {light_rows}")
        change = {
            "albedo": torch.zeros(texture, texture, 3, requires_grad=True),
            "roughness": torch.zeros(texture, texture, 1, requires_grad=True),
            "log_light": torch.zeros(light_rows, 2 * light_rows, 3, requires_grad=True),
        }
        return Jacobian(self.tone_mapped(pixels, change, seed=seed), change)

    def tone_mapped(self, pixels: Tensor, change: Mapping[str, Tensor], *, seed: int) -> Tensor:
        """Tone-mapped radiance (P, 3) of the truth plus a change of :meth:`jacobian`; samples follow the true light."""
        texture_side = self.material.albedo.shape[0] // change["albedo"].shape[0]
        light_side = self.log_light.shape[0] // change["log_light"].shape[0]
        albedo = self.material.albedo + _blocks(change["albedo"], texture_side)
        roughness = self.material.roughness + _blocks(change["roughness"], texture_side)
        radiance = torch.exp(self.log_light + _blocks(change["log_light"], light_side))
        true = SampledLight.of(torch.exp(self.log_light), uniform_fraction=FitSettings().defensive_share)
        rendered = self.renderer.render_pixels(
            self.gbuffer,
            pixels,
            Material(albedo, roughness, self.material.metallic),
            SampledLight(radiance, true.sampler),
            self.samples,
            torch.Generator().manual_seed(seed),
        )
        return tone_map(rendered.radiance)

    def block_radiance(self, light_rows: int) -> Tensor:
        """Mean true radiance (h, 2 h, 3) of the light's blocks of :meth:`jacobian`."""
        return _resized(torch.exp(self.log_light), light_rows, 2 * light_rows)


def _resized(image: Tensor, height: int, width: int | None = None) -> Tensor:
    """Block means of (H, W, C); repeated texels where it grows."""
    size = (height, width or height)
    return F.interpolate(image.permute(2, 0, 1)[None], size=size, mode="area")[0].permute(1, 2, 0).contiguous()


def _blocks(coarse: Tensor, side: int) -> Tensor:
    """Every texel of (h, w, C) as a block of ``side`` x ``side`` texels."""
    return coarse.repeat_interleave(side, 0).repeat_interleave(side, 1)
