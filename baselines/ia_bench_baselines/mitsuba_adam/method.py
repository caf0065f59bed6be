"""A plain loop of Mitsuba 3: its differentiable renderer, its Adam, one random training view a step."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result

if importlib.util.find_spec("mitsuba") is None:  # told once, where plugins are listed or asked for, and before any fit
    raise ImportError("it needs Mitsuba 3: pip install mitsuba==3.9.1, and libLLVM")


class MitsubaAdam:
    """Adam on albedo, roughness and the log radiance of the light; what it lacks beside ``two_stage`` is in loop.py."""

    Options: ClassVar[type] = MitsubaAdamOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"smoke": {"steps": 8}, "full": {"steps": 3000}, "paper": {"steps": 35000}}
    info = MethodInfo(uses_prior=True)

    def __init__(self, options: MitsubaAdamOptions) -> None:
        """``options``: see :class:`MitsubaAdamOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant, or from the prior's albedo. Resumes from the monitor's checkpoint to the same numbers.

        Raises InputError where Mitsuba cannot render.
        """
        from ia_bench.methods.couplings.sampler import PriorSampler
        from ia_bench.methods.descent import Descent, Phase
        from ia_bench_baselines.mitsuba_adam.loop import Loop
        from ia_bench_baselines.mitsuba_adam.reconstruction import MitsubaReconstruction

        options = self.options
        wanted = "albedo" in problem.prior.info.provides and options.albedo_weight > 0
        with problem.costs.exclude("bake"):
            problem.gbuffer  # noqa: B018 (made here, and the plan)
            loop = Loop(problem, options, seed=seed)

        def start() -> None:
            albedo = None
            if wanted:
                with descent.book("prior"):
                    sampler = PriorSampler(problem, problem.prior, seed, monitor.note)
                    albedo = dict(zip(problem.asked_views, sampler.draw(None).values["albedo"], strict=True))
                descent.seconds["prior"] += sampler.kept_seconds
                descent.counters.update(sampler.counters)
            loop.start(albedo)

        def found() -> MitsubaReconstruction:
            return MitsubaReconstruction(problem.stage, *loop.recovered(), depth=options.depth)

        phase = Phase("loop", options.steps, step=lambda step, _: loop.advance(step))
        descent = Descent({}, [phase], seed=seed, monitor=monitor, start=start, beside={"loop": loop})
        return descent.run(found)
