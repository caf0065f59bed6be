"""NeILF++ (Zhang et al. 2023) on a shared mesh: incident light as a network of position and direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.ranges import Count, Number, Rate, Weight
from ia_bench.methods.info import MethodInfo

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
        glossy: Directions of a pixel of a step beside these, by the gloss of its material.
        rendered_directions: Directions over the sphere of a pixel of view synthesis, whose points share them out.
        rendered_glossy: The same of those by the gloss.
        traced: Pairs of a pixel and a direction whose ray is traced in every step for the trace loss.
        width: Channels of a hidden layer of all networks.
        finest: Cells along a side of the finest level of the hash grids, over the object's ball.
        grid_rate: AdamW rate of hash grids.
        rate: AdamW rate of networks, a fifth after a third of the joint phase, and a twenty-fifth after two thirds.
        trace_weight: Weight of the distance between incident light and the surface light field where rays hit.
        metallic_weight: Weight of the mean metal.
        smooth_weight: Weight of the gradients of roughness and metal over the surface, where images have none.
    """

    surface_light_steps: Number = 600
    material_steps: Count = 100
    joint_steps: Number = 1000
    pixels: Number = 256
    surface_light_pixels: Number = 256
    directions: Number = 96
    glossy: Number = 16
    rendered_directions: Number = 1024
    rendered_glossy: Number = 256
    traced: Number = 2048
    width: Number = 64
    finest: Number = 128
    grid_rate: Rate = 0.01
    rate: Rate = 0.002
    trace_weight: Weight = 0.1
    metallic_weight: Weight = 0.005
    smooth_weight: Weight = 0.00005


if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Neilfpp:
    """A material network and an incident light field, tied by traced rays to the light that the surface sends out."""

    Options: ClassVar[type] = NeilfppOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"surface_light_steps": 30, "material_steps": 5, "joint_steps": 30, "rendered_directions": 64},
        "full": {"surface_light_steps": 2400, "material_steps": 400, "joint_steps": 4000},
        "paper": {
            "surface_light_steps": 5000,
            "material_steps": 1000,
            "joint_steps": 30_000,
            "pixels": 8192,
            "surface_light_pixels": 8192,
            "directions": 256,
            "rendered_directions": 2048,
            "traced": 8192,
            "width": 128,
            "finest": 512,
            "smooth_weight": 0.0005,
        },
    }
    info = MethodInfo(uses_prior=False)

    def __init__(self, options: NeilfppOptions) -> None:
        """``options``: see :class:`NeilfppOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """AdamW in three phases. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.neilfpp.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
