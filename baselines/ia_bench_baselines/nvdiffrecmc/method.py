"""nvdiffrecmc (Hasselgren et al. 2022) on a shared mesh: Monte Carlo shading, few samples, a denoiser in the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.nvdiffrecmc.settings import NvdiffrecmcOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Nvdiffrecmc:
    """Adam on base colour, roughness, metal and the light's log radiance, from the L1 of denoised, tone-mapped views."""

    Options: ClassVar[type] = NvdiffrecmcOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"steps": 30},
        "full": {"steps": 4000},
        "paper": {"steps": 35_000},
    }
    info = MethodInfo(
        uses_prior=False,
        paper="J. Hasselgren et al., Shape, Light, and Material Decomposition from Images using Monte Carlo Rendering and "
        "Denoising, NeurIPS 2022",
        deviations=(
            "The mesh is given: of its two phases only the second, textures on a mesh, is left.",
            "Two techniques share the samples, light and GGX: there are no samples by the cosine.",
            "The light is a lat-long map of log radiances, not a probe of radiances; a step takes one view, not eight.",
        ),
    )

    def __init__(self, options: NvdiffrecmcOptions) -> None:
        """``options``: see :class:`NvdiffrecmcOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.nvdiffrecmc.fit import Fit

        return Fit(problem, self.options, seed=seed, monitor=monitor).finish()
