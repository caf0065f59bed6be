"""The plain way to do it with Mitsuba 3: its renderer, its Adam, one random view a step.

What it shares with our fit: the scene, the sizes of textures and light, the tone map of the image loss, the L1 loss in
sRGB of a prior's albedo, the learning rates and their decay, the log radiance of the light, the start. What it has not:
samples in halves that judge each other (its image loss is `image_loss=l1`), batches of pixels from all views, stratified
samples, smoothness, delays of single parameters, a step of light and albedo together, a target of the shading.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench_baselines.mitsuba_adam.scene import MitsubaScene

START_RAYS = 16  # camera rays a pixel of the renders that set the initial light


class MitsubaFit:
    """Albedo, roughness and light of a scene without truth, fitted by Mitsuba."""

    def __init__(
        self,
        problem: Problem,
        settings: FitSettings,
        steps: int,
        *,
        albedo: Sequence[np.ndarray] | None = None,
        samples: int | None = None,
        integrator: str = "prb",
        threads: int | None = None,
        seed: int = 0,
    ) -> None:
        """``albedo``: a prior's images, one premultiplied (H, W, 3) for each training view, or None for no prior.

        ``samples`` a pixel and step, by default as many as the plan has. ``integrator``: "prb" or "direct", whose attached
        samples make the gradient of the roughness so noisy that long fits diverge. Raises InputError where Mitsuba is missing.
        """
        self.step, self._steps, self._final = 0, steps, settings.rates.final
        self._random = np.random.default_rng(seed)
        views, rows, self._stage = problem.scene.train, problem.plan.light_height, problem.stage
        self._scene = MitsubaScene(
            problem.scene.mesh,
            [view.camera for view in views],
            initial_material(problem, settings, albedo),
            torch.ones(rows, 2 * rows, 3),
            integrator=integrator,
            threads=threads,
        )
        mi = self._scene.mi
        self._rays = max(1, round((samples or problem.plan.samples) / self._scene.samples_per_ray))
        self._images = [mi.TensorXf(np.ascontiguousarray(view.image, np.float32)) for view in views]
        self._albedo = None if albedo is None else [mi.TensorXf(np.ascontiguousarray(a, np.float32)) for a in albedo]
        names, rates = self._scene.names, settings.rates
        self._rates = {names["albedo"]: rates.albedo, names["roughness"]: rates.roughness, "log_light": rates.light}
        self._weight = settings.weights.albedo / settings.weights.image
        self._optimizer = mi.ad.Adam(lr=rates.albedo, beta_1=0.9, beta_2=0.99)
        for key in (names["albedo"], names["roughness"]):
            self._optimizer[key] = self._scene.parameters[key]
        seen = np.mean([view.image.mean((0, 1)) for view in views], axis=0)
        unlit = np.mean([self._scene.image(view, START_RAYS, 0).mean((0, 1)) for view in range(len(views))], axis=0)
        light = np.log(np.maximum(seen, 1e-8) / np.maximum(unlit, 1e-8))
        shape = self._scene.parameters[names["light"]].shape
        self._optimizer["log_light"] = mi.TensorXf(np.broadcast_to(light, shape).astype(np.float32))
        self._show()

    def advance(self) -> None:
        """One step: a random view, its loss, Adam, and the projection onto valid values."""
        dr, names = self._scene.dr, self._scene.names
        view = int(self._random.integers(len(self._images)))
        decay = self._final ** (self.step / max(self._steps - 1, 1))
        self._optimizer.set_learning_rate({key: rate * decay for key, rate in self._rates.items()})
        rendered = self._scene.render(view, self._rays, seed=self.step)
        loss = dr.mean(dr.abs(self._tone_map(rendered) - self._tone_map(self._images[view])))
        if self._albedo is not None:
            difference = self._srgb(self._scene.albedo(view)) - self._srgb(self._albedo[view])
            loss += self._weight * dr.mean(dr.abs(difference))
        dr.backward(loss)
        self._optimizer.step()
        for key, low in ((names["albedo"], 0.0), (names["roughness"], MIN_ROUGHNESS)):
            self._optimizer[key] = dr.clip(dr.detach(self._optimizer[key]), low, 1.0)
        self._show()
        dr.sync_thread()
        self.step += 1

    def snapshot(self) -> TexturedReconstruction:
        """What has been found so far, in our conventions."""
        names, parameters = self._scene.names, self._scene.parameters
        albedo, roughness = (torch.from_numpy(np.array(parameters[names[k]])) for k in ("albedo", "roughness"))
        light = np.exp(np.array(self._optimizer["log_light"]))[:, 1:-1, :3]
        material = Material(albedo, roughness.reshape(*roughness.shape[:2], 1))
        return TexturedReconstruction(self._stage, material, torch.from_numpy(light.copy()), coat="added")

    def _show(self) -> None:
        """Give the optimiser's values to the scene."""
        names = self._scene.names
        for key in (names["albedo"], names["roughness"]):
            self._scene.parameters[key] = self._optimizer[key]
        self._scene.parameters[names["light"]] = self._scene.dr.exp(self._optimizer["log_light"])
        self._scene.parameters.update()

    def _srgb(self, linear: Any) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        dr = self._scene.dr
        return dr.select(linear <= 0.0031308, 12.92 * linear, 1.055 * dr.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)

    def _tone_map(self, radiance: Any) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        return self._srgb(self._scene.dr.log(1 + radiance))


def initial_material(problem: Problem, settings: FitSettings, albedo: Sequence[np.ndarray] | None) -> Material:
    """Where our fit starts: the prior's albedo averaged in texture space, or a constant of the images' mean colour."""
    size, gbuffer = problem.plan.texture, problem.gbuffer
    roughness = torch.full((size, size, 1), settings.roughness_initial)
    if albedo is None:
        mean = problem.pixels_of(torch.stack([torch.from_numpy(view.image) for view in problem.scene.train])).mean(0)
        colour: Tensor = settings.albedo_initial * mean / mean.mean().clamp_min(1e-8)
        return Material((colour / colour.max().clamp_min(1)).expand(size, size, 3).contiguous(), roughness)
    hit = gbuffer.face >= 0
    uv = problem.renderer.surface.uv(gbuffer.face[hit].long(), gbuffer.barycentric[hit])
    target = problem.pixels_of(torch.stack([torch.from_numpy(np.asarray(image)) for image in albedo]).float())
    values = (target / hit.float().mean(1, keepdim=True))[:, None].expand(-1, gbuffer.subsamples, -1)[hit]
    average, weight = splat(uv, values, size)
    return Material(fill_unobserved(average, weight > 0).clamp(0, 1), roughness)
