"""A reconstruction without a texture, a mesh or a ray tracer of ours: an analytic ball under one spherical Gaussian."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ia_bench.light.environment import Environment
from ia_bench.light.latlong import texel_centres
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.reconstruction import Assets, Quality
from ia_bench.render.stage import Stage
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera


@dataclass(frozen=True)
class Gaussian:
    """Radiance amplitude exp(sharpness (axis . direction - 1)) (Wang et al. 2009)."""

    axis: tuple[float, float, float] = (0.6, 0.0, 0.8)
    sharpness: float = 4.0
    amplitude: tuple[float, float, float] = (3.0, 2.5, 2.0)

    def radiance(self, directions: torch.Tensor) -> torch.Tensor:
        cosine = directions @ torch.tensor(self.axis)
        return torch.exp(self.sharpness * (cosine - 1))[:, None] * torch.tensor(self.amplitude)

    def latlong(self, height: int) -> torch.Tensor:
        return self.radiance(texel_centres(height, 2 * height).reshape(-1, 3)).reshape(height, 2 * height, 3)


@dataclass(frozen=True)
class Ball:
    """A matt ball of one albedo. Its renderer takes the light along the normal for all of it."""

    albedo: tuple[float, float, float] = (0.5, 0.4, 0.3)
    roughness: float | None = 0.5
    environment: Environment | None = Gaussian()
    exported: Assets | None = None
    renderer: str = "light along the normal"

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        values = {"albedo": self.albedo, "roughness": self.roughness}
        return {name: self._pictures(cameras, points, values[name]) for name in names if values[name] is not None}

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: torch.Tensor | None, quality: Quality
    ) -> Images | None:
        chosen = self.environment if light is None else light
        if chosen is None:
            return None
        colour = np.asarray(self.albedo) * (1 if albedo_scale is None else albedo_scale.numpy())
        return self._pictures(cameras, quality.points, colour, chosen)

    def assets(self) -> Assets | None:
        return self.exported

    def _pictures(self, cameras: Sequence[Camera], points: int, value: object, light: Environment | None = None) -> Images:
        images, coverage = [], []
        for camera in cameras:
            origin, direction = primary_rays(camera, points)
            along = -(origin * direction).sum(-1, keepdims=True)
            squared = 1 - (origin**2).sum(-1, keepdims=True) + along**2
            hit = squared[..., 0] > 0
            normal = (origin + (along - np.sqrt(squared.clip(0))) * direction).astype(np.float32)
            shown = hit[..., None] * np.asarray(value, np.float32)
            if light is not None:
                shown[hit] *= light.radiance(torch.from_numpy(normal[hit])).numpy()
            pixel = shown.mean(2)
            images.append(pixel if np.size(value) == 3 else pixel[..., 0])
            coverage.append(hit.mean(2))
        return Images(tuple(images), tuple(coverage))


def as_assets(ball: Ball, stage: Stage) -> Ball:
    """The same ball, which also exports its colours onto a mesh."""
    material = Material(torch.tensor(ball.albedo).expand(4, 4, 3), torch.full((4, 4, 1), ball.roughness or 0.5))
    light = None if ball.environment is None else ball.environment.latlong(16).numpy()
    exported = Assets(stage.mesh, material.albedo.numpy().copy(), material.roughness[..., 0].numpy(), light=light)
    return replace(ball, exported=exported)


def mapped(images: Images, change: Callable[[np.ndarray], np.ndarray]) -> Images:
    """Apply a change to the un-premultiplied colours."""
    weights = [c if i.ndim == 2 else c[..., None] for i, c in zip(images.images, images.coverage, strict=True)]
    colours = (i / np.where(w > 0, w, 1) for i, w in zip(images.images, weights, strict=True))
    return Images(tuple(change(c) * w for c, w in zip(colours, weights, strict=True)), images.coverage)
