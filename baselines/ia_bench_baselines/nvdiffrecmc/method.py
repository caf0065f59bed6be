"""nvdiffrecmc (Hasselgren et al. 2022) on a shared mesh: Monte Carlo shading, few samples, a denoiser in the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.ranges import Count, NotNegative, Number, Positive, Rate, UnitInterval, Weight
from ia_bench.methods.info import MethodInfo


@dataclass(frozen=True)
class NvdiffrecmcOptions:
    """Sizes of textures and light are the plan's, ``render.texture`` and ``render.light_height``.

    Attributes:
        steps: Of Adam; each renders one training view.
        samples: Directions of light a pixel, one shadow ray each: half by the light, half by the BRDF, and two a point at least.
        material_rate: Adam rate of the textures.
        light_rate: Adam rate of the log radiance of the light.
        final_rate: What the rates fall to over the fit, as a fraction.
        roughness_initial: Roughness at the start.
        metallic_initial: Metal at the start.
        denoiser_width: Of the denoiser's window at the end, standard deviation in pixels; 0 is no denoiser.
        denoiser_steps: In which it grows from nothing to that: half of ``steps`` in every preset.
        smooth_colour: Weight of the base colour's change between points near by.
        smooth_material: Weight of the same of roughness and metal.
        smooth_texels: Standard deviation of their distance, texels.
        monochrome_light: Weight of what keeps the demodulated light as bright as the photographs and leaves hue to the base colour.
        defensive_share: Share of light samples spread over the sphere, so that dark texels are visited too.
    """

    steps: Number = 1000
    samples: Number = 32
    material_rate: Rate = 0.03
    light_rate: Rate = 0.1
    final_rate: Positive = 0.05
    roughness_initial: UnitInterval = 0.5
    metallic_initial: UnitInterval = 0.1
    denoiser_width: NotNegative = 2.0
    denoiser_steps: Count = 500
    smooth_colour: Weight = 0.03
    smooth_material: Weight = 0.2
    smooth_texels: Positive = 1.0
    monochrome_light: Weight = 0.05
    defensive_share: UnitInterval = 0.2


if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Nvdiffrecmc:
    """Adam on base colour, roughness, metal and the light's log radiance, from the L1 of denoised, tone-mapped views."""

    Options: ClassVar[type] = NvdiffrecmcOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"steps": 30, "denoiser_steps": 15},
        "full": {"steps": 4000, "denoiser_steps": 2000},
        "paper": {"steps": 35_000, "denoiser_steps": 17_500},
    }
    info = MethodInfo(uses_prior=False)

    def __init__(self, options: NvdiffrecmcOptions) -> None:
        """``options``: see :class:`NvdiffrecmcOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.nvdiffrecmc.fit import Fit

        return Fit(problem, self.options, seed=seed, monitor=monitor).finish()
