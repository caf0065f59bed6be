"""TensoIR (Jin et al. 2023) on a shared mesh: one low-rank tensor for what is seen and for what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.tensoir.settings import TensoirOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Tensoir:
    """A radiance head and a material head on one vector-matrix tensor, under a light of spherical Gaussians."""

    Options: ClassVar[type] = TensoirOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {
            "radiance_steps": 30,
            "coarse_steps": 25,
            "fine_steps": 5,
            "radiance_pixels": 512,
            "rows": 8,
            "rendered_directions": 128,
            "coarse": 16,
            "fine": 24,
        },
        "full": {"radiance_steps": 1600, "coarse_steps": 1200, "fine_steps": 1200},
        "paper": {
            "radiance_steps": 10_000,
            "coarse_steps": 10_000,
            "fine_steps": 60_000,
            "radiance_pixels": 4096,
            "pixels": 4096,
            "coarse": 128,
            "fine": 300,
            "components": 48,
            "network_rate": 0.001,
        },
    }
    info = MethodInfo(
        uses_prior=False,
        paper="H. Jin et al., TensoIR: Tensorial Inverse Rendering, CVPR 2023",
        deviations=(
            "The mesh is given: there is no density, no head of normals, and shadows are traced.",
            "The tensor is refined once, not four times.",
            "The images of both heads weigh the same; the original gives those of the material a fifth.",
            "Sharpness and amplitude of the light are found by their logarithms, at a higher rate, in fewer steps.",
            "Novel lights are fitted by spherical Gaussians, as IntrinsicAnything has it; the released code samples them.",
        ),
    )

    def __init__(self, options: TensoirOptions) -> None:
        """``options``: see :class:`TensoirOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam in three phases. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.tensoir.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
