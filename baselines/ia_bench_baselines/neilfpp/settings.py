"""What may be set of NeILF++ on a shared mesh."""

from __future__ import annotations

from dataclasses import dataclass

from ia_bench.common.ranges import Count, Number, Rate, Weight

LEAST_ROUGHNESS = 0.1  # a narrower lobe falls between the directions of any affordable quadrature


@dataclass(frozen=True)
class NeilfppOptions:
    """Sizes and weights; the size of the exported textures is the plan's, ``render.texture``.

    Attributes:
        surface_light_steps: AdamW steps of the surface light field alone.
        material_steps: Then steps of material and incident light, the surface light field held.
        joint_steps: Then steps of all three.
        pixels: In every step, from all training views.
        surface_light_pixels: In every step of the first phase, where a pixel is one evaluation of one network.
        directions: Of incident light over the whole sphere, shared by the pixels of a step; about half are above a horizon.
        rendered_directions: The same, of view synthesis, for every point.
        traced: Pairs of a pixel and a direction whose ray is traced in every step for the trace loss.
        width: Channels of a hidden layer of both light fields.
        material_width: Channels of a hidden layer of the material's network.
        layers: Hidden layers of every network; the second input enters in the middle.
        rate: AdamW rate, a fifth after a third of the joint phase, and a twenty-fifth after two thirds.
        trace_weight: Weight of the distance between incident light and the surface light field where rays hit.
        metallic_weight: Weight of the mean metal.
        smooth_weight: Weight of the gradients of roughness and metal over the surface, where images have none.
    """

    surface_light_steps: Number = 600
    material_steps: Count = 100
    joint_steps: Number = 900
    pixels: Number = 256
    surface_light_pixels: Number = 1024
    directions: Number = 128
    rendered_directions: Number = 256
    traced: Number = 2048
    width: Number = 64
    material_width: Number = 128
    layers: Number = 6
    rate: Rate = 0.0003
    trace_weight: Weight = 0.1
    metallic_weight: Weight = 0.005
    smooth_weight: Weight = 0.00005

    def __post_init__(self) -> None:
        """Raises ValueError where there is no middle for the second input to enter."""
        if self.layers < 2:
            raise ValueError(f"layers: expected at least 2, found {self.layers}")
