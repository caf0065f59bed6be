"""Render what a fit predicts for the test and novel views, so that it can be compared with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer, trace_gbuffer
from ia_bench.render.rays import RayCaster
from ia_bench.render.renderer import Renderer, texture_images
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Scene, View
from ia_bench.scores.evaluate import albedo_scale, score, score_quick
from ia_bench.scores.predictions import Predictions
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.result import Scores

QUICK_STRIDE = 4  # the curve during a run looks at every 4th view ...
QUICK_SAMPLES = 32  # ... with at most this many samples a pixel
SIDE = 2  # G-buffer points along a side of a pixel, whatever the fit used: scores must not depend on the plan


@dataclass(frozen=True)
class Shot:
    """The views of one split under one light, with their G-buffer."""

    views: tuple[View, ...]
    gbuffer: GBuffer

    def truth(self, component: str) -> Images | None:
        """Ground truth (or, for "image", the photographs) of every view; None if a view lacks it."""
        values = [getattr(view, component) for view in self.views]
        if any(value is None for value in values):
            return None
        return Images(tuple(values), tuple(view.mask for view in self.views))


class Scorer:
    """Scores of fits on one scene. Besides the ceiling and priors that declare sees_truth, the only place that reads truth."""

    def __init__(self, scene: Scene, renderer: Renderer, rays: RayCaster, protocol: Protocol, *, seed: int) -> None:
        """``scene`` must have been loaded with its truth; nothing is rendered yet."""
        if scene.truth is None:
            raise ValueError("scoring needs a scene that was loaded with its ground truth")
        self._scene, self._renderer, self._rays = scene, renderer, rays
        self._protocol, self._seed = protocol, seed
        self._gbuffers: dict[bytes, GBuffer] = {}
        lights = dict.fromkeys(view.light for view in scene.novel)
        self._novel = {light: tuple(view for view in scene.novel if view.light == light) for light in lights}

    def full(self, material: Material, light: Tensor) -> Scores:
        """Every number of the protocol for ``material`` and the recovered ``light`` (H, W, 3)."""
        predicted, true = self._predict(material, light, 1, self._protocol.samples_per_pixel)
        scores = score(predicted, true, self._protocol)
        for name in self._novel:
            if name != "train" and self._light(name) is None:
                scores.reasons[f"per_image.relighting.{name}"] = "left out: the scene has no environment map of this light"
        return scores

    def quick(self, material: Material, light: Tensor) -> dict[str, float | None]:
        """The metric columns of curve.csv, from a fixed subset of the views."""
        samples = min(QUICK_SAMPLES, self._protocol.samples_per_pixel)
        return score_quick(*self._predict(material, light, QUICK_STRIDE, samples), self._protocol)

    def _predict(self, material: Material, light: Tensor, stride: int, samples: int) -> tuple[Predictions, Predictions]:
        predicted: dict[str, object] = {}
        true: dict[str, object] = {}
        scale: np.ndarray | None = None
        test = self._shot(self._scene.test[::stride])
        if test is not None and test.truth("albedo") is not None:
            coverage = _arrays(test.gbuffer.coverage())
            albedo = texture_images(self._renderer.surface, test.gbuffer, material.albedo)
            predicted["albedo"], true["albedo"] = Images(_arrays(albedo), coverage), test.truth("albedo")
            scale = albedo_scale(predicted["albedo"], true["albedo"], self._protocol).scale  # type: ignore[arg-type]
            if test.truth("roughness") is not None:
                roughness = texture_images(self._renderer.surface, test.gbuffer, material.roughness)[..., 0]
                predicted["roughness"], true["roughness"] = Images(_arrays(roughness), coverage), test.truth("roughness")
        if "train" in self._novel:
            shot = self._shot(self._novel["train"][::stride])
            assert shot is not None
            predicted["view_synthesis"], true["view_synthesis"] = self._render(shot, material, light, samples)
        novel = {name: views for name, views in self._novel.items() if name != "train" and self._light(name) is not None}
        if scale is not None and novel:
            factor = torch.from_numpy(scale).to(material.albedo)
            aligned = replace(material, albedo=material.albedo * factor)
            rendered = {}
            for name, views in novel.items():
                shot, radiance = self._shot(views[::stride]), self._light(name)
                assert shot is not None
                assert radiance is not None
                rendered[name] = self._render(shot, aligned, radiance, samples)
            predicted["relighting"] = {name: pair[0] for name, pair in rendered.items()}
            true["relighting"] = {name: pair[1] for name, pair in rendered.items()}
        return Predictions(**predicted), Predictions(**true)  # type: ignore[arg-type]

    def _light(self, name: str) -> Tensor | None:
        assert self._scene.truth is not None
        radiance = self._scene.truth.lights.get(name)
        return None if radiance is None else torch.from_numpy(radiance)

    def _shot(self, views: Sequence[View]) -> Shot | None:
        if not views:
            return None
        cameras = [view.camera for view in views]
        key = b"".join(_key(camera) for camera in cameras)
        if key not in self._gbuffers:
            device = self._renderer.surface.device
            self._gbuffers[key] = trace_gbuffer(cameras, self._rays, SIDE, device)
        return Shot(tuple(views), self._gbuffers[key])

    def _render(self, shot: Shot, material: Material, light: Tensor, samples: int) -> tuple[Images, Images]:
        device = material.albedo.device
        generator = torch.Generator(device=device).manual_seed(self._seed)
        rendered = self._renderer.render_images(shot.gbuffer, material, SampledLight.of(light.to(device)), samples, generator)
        truth = shot.truth("image")
        assert truth is not None
        return Images(_arrays(rendered["radiance"]), _arrays(shot.gbuffer.coverage())), truth


def _key(camera: Camera) -> bytes:
    return camera.to_world.tobytes() + repr((camera.focal, camera.centre, camera.width, camera.height)).encode()


def _arrays(images: Tensor) -> tuple[np.ndarray, ...]:
    return tuple(images.cpu().numpy())
