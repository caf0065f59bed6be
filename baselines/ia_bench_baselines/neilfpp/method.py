"""NeILF++ (Zhang et al. 2023) on a shared mesh: incident light as a network of position and direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.neilfpp.settings import NeilfppOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Neilfpp:
    """A material network and an incident light field, tied by traced rays to the light that the surface sends out."""

    Options: ClassVar[type] = NeilfppOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"surface_light_steps": 30, "material_steps": 5, "joint_steps": 30, "rendered_directions": 64},
        "full": {"surface_light_steps": 2400, "material_steps": 400, "joint_steps": 3600},
        "paper": {
            "surface_light_steps": 5000,
            "material_steps": 1000,
            "joint_steps": 30_000,
            "pixels": 8192,
            "surface_light_pixels": 8192,
            "directions": 256,
            "rendered_directions": 512,
            "traced": 8192,
            "width": 128,
            "material_width": 512,
            "layers": 8,
            "rate": 0.002,
            "smooth_weight": 0.0005,
        },
    }
    info = MethodInfo(
        uses_prior=False,
        paper="J. Zhang et al., NeILF++: Inter-Reflectable Light Fields for Geometry and Material Estimation, ICCV 2023",
        deviations=(
            "The mesh is given, as in the paper's own configuration for known geometry.",
            "The directions of a step are shared by its pixels, so that the layers that see only a direction run once.",
            "Light has three channels, as in the original for images of high dynamic range.",
            "The rate and the weight of smoothness are smaller, for fits that are shorter.",
            "The variance prior of the first steps on real photographs is left out.",
        ),
    )

    def __init__(self, options: NeilfppOptions) -> None:
        """``options``: see :class:`NeilfppOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """AdamW in three phases. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.neilfpp.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
