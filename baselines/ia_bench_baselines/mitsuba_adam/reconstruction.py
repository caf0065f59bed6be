"""What Mitsuba recovered, rendered by Mitsuba."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Assets, Quality, TexturedReconstruction
from ia_bench.render.settings import REFERENCE_LIGHT_ROWS
from ia_bench.render.stage import Stage
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera
from ia_bench_baselines.mitsuba_adam.scene import MitsubaScene


class MitsubaReconstruction:
    """Textures and a lat-long light, lit and seen as they were fitted: see :class:`ia_bench.render.reconstruction.Reconstruction`.

    Mitsuba places its samples anywhere in a pixel, so that a quality's ``points`` decide the maps and the coverage alone.
    """

    def __init__(self, stage: Stage, material: Material, light: Tensor, *, depth: int) -> None:
        """``light`` (H, W, 3) radiance; ``depth``: of the longest light path. Mitsuba's are on the CPU, wherever the stage is."""
        albedo, roughness, light = (part.to(stage.device) for part in (material.albedo, material.roughness, light))
        self._textures = TexturedReconstruction(stage, Material(albedo, roughness), light)
        self._stage, self._depth = stage, depth
        self.environment: Environment | None = self._textures.environment
        self.renderer = f"Mitsuba 3, principled, paths of up to {depth}"

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.maps`."""
        return self._textures.maps(cameras, names, points=points)

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.render`."""
        chosen = self.environment if light is None else light
        assert chosen is not None
        texels = chosen.texels if isinstance(chosen, LatLongEnvironment) else chosen.latlong(REFERENCE_LIGHT_ROWS)
        material = self._textures.material
        if albedo_scale is not None:
            material = replace(material, albedo=material.albedo * albedo_scale.to(material.albedo))
        threads = torch.get_num_threads()
        mesh, depth = self._stage.mesh, self._depth
        scene = MitsubaScene(mesh, cameras, material, texels.cpu(), depth=depth, threads=threads)
        rays = max(1, round(quality.samples / scene.samples_per_ray))
        images = [scene.image(view, rays, (quality.seed + view) % 2**32) for view in range(len(cameras))]
        coverage = [cover.cpu().numpy() for part in self._stage.gbuffers(cameras, quality.points) for cover in part.coverage()]
        return Images(tuple(images), tuple(coverage))

    def assets(self) -> Assets:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.assets`."""
        return self._textures.assets()
