"""What nvdiffrecmc recovered, drawn as it was fitted: by direct light alone."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera


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
