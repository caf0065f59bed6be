"""What may be set of nvdiffrec on a shared mesh."""

from __future__ import annotations

from dataclasses import dataclass

from ia_bench.common.ranges import Number, Positive, Rate, UnitInterval, Weight


@dataclass(frozen=True)
class NvdiffrecOptions:
    """Sizes of textures and light are the plan's, ``render.texture`` and ``render.light_height``.

    Attributes:
        steps: Of Adam.
        pixels: In every step, from all training views.
        material_rate: Adam rate of the textures.
        light_rate: Adam rate of the log radiance of the light.
        final_rate: What the rates fall to over the fit, as a fraction.
        roughness_initial: Roughness at the start.
        metallic_initial: Metal at the start.
        smooth_colour: Weight of the base colour's change between points near by.
        smooth_material: Weight of the same of roughness and metal.
        smooth_texels: Standard deviation of their distance, texels.
        grey_light: Weight of the light's mean absolute distance from grey, which leaves hue to the base colour.
    """

    steps: Number = 1500
    pixels: Number = 4096
    material_rate: Rate = 0.03
    light_rate: Rate = 0.1
    final_rate: Positive = 0.05
    roughness_initial: UnitInterval = 0.5
    metallic_initial: UnitInterval = 0.1
    smooth_colour: Weight = 0.03
    smooth_material: Weight = 0.2
    smooth_texels: Positive = 1.0
    grey_light: Weight = 0.005
