"""nvdiffrec (Munkberg et al. 2022) on a shared mesh: textures and a light by split-sum shading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.ranges import Number, Positive, Rate, UnitInterval, Weight
from ia_bench.methods.info import MethodInfo


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


if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Nvdiffrec:
    """Adam on base colour, roughness, metal and the light's log radiance, from the L1 of tone-mapped pixels."""

    Options: ClassVar[type] = NvdiffrecOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"steps": 60, "pixels": 512},
        "full": {"steps": 6000},
        "paper": {"steps": 40_000},
    }
    info = MethodInfo(uses_prior=False)

    def __init__(self, options: NvdiffrecOptions) -> None:
        """``options``: see :class:`NvdiffrecOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.nvdiffrec.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
