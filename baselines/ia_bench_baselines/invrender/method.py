"""InvRender (Zhang et al. 2022) on a given mesh, without its signed distance field and with traced visibility."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.invrender.settings import InvRenderOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class InvRender:
    """Adam on a sparse latent material and 128 spherical Gaussians, shaded in closed form; card.md says what differs."""

    Options: ClassVar[type] = InvRenderOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"radiance_steps": 8, "indirect_steps": 4, "steps": 8, "atlas": 32, "directions": 64, "texture": 64},
        "full": {"radiance_steps": 3200, "indirect_steps": 1600, "steps": 7200},
        "paper": {
            "radiance_steps": 200000,
            "indirect_steps": 10000,
            "steps": 10000,
            "pixels": 1024,
            "width": 512,
            "octaves": 10,
            "network_rate": 5e-4,
        },
    }
    info = MethodInfo(
        uses_prior=False,
        paper="Y. Zhang et al., Modeling Indirect Illumination for Inverse Rendering, CVPR 2022, arXiv 2204.06837",
        deviations=(
            "The mesh is given: there is no signed distance field.",
            "Visibility is traced, a ray a lobe, instead of learned by a network.",
            "Positions are encoded by 7 octaves instead of 10, as fine as these smaller images are.",
            "Networks have 128 units a layer, and phases have fewer steps of higher rates.",
            "Logarithms of the light's sharpness and amplitude are fitted.",
            "What is metal in the scene is fitted as a dielectric.",
        ),
    )

    def __init__(self, options: InvRenderOptions) -> None:
        """``options``: see :class:`InvRenderOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Three phases of Adam. Resumes from the monitor's checkpoint to the same numbers.

        Raises InputError where no training pixel shows the object alone.
        """
        import time
        from dataclasses import replace

        from ia_bench.methods.descent import Descent
        from ia_bench_baselines.invrender.fitting import Fitting

        problem.stage  # noqa: B018 (made here, and booked as baking)
        started = time.perf_counter()
        fitting = Fitting(problem, self.options, seed)
        traced = time.perf_counter() - started
        found = Descent(fitting.model, fitting.phases(), seed=seed, monitor=monitor).run(fitting.recovered)
        return replace(found, seconds={"visibility": traced, **found.seconds})
