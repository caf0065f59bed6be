"""nvdiffrec (Munkberg et al. 2022) on a shared mesh: textures and a light by split-sum shading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.nvdiffrec.settings import NvdiffrecOptions

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
    info = MethodInfo(
        uses_prior=False,
        paper="J. Munkberg et al., Extracting Triangular 3D Models, Materials, and Lighting From Images, CVPR 2022",
        deviations=(
            "The mesh is given: of its two phases only the second, textures on a mesh, is left.",
            "The light is a lat-long map of log radiances, not a cube map of radiances.",
            "Pixels of a step come from all views, not from eight whole images.",
        ),
    )

    def __init__(self, options: NvdiffrecOptions) -> None:
        """``options``: see :class:`NvdiffrecOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.nvdiffrec.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
