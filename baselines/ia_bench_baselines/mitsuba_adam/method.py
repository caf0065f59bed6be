"""A plain loop of Mitsuba 3: its differentiable renderer, its Adam, one random training view a step."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.methods.info import MethodInfo
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result

if importlib.util.find_spec("mitsuba") is None:  # told once, where plugins are listed or asked for, and before any fit
    raise ImportError("it needs Mitsuba 3: pip install mitsuba==3.9.1, and libLLVM")

FIRST_SCORE = 25  # steps; later scores follow at doubling steps


class MitsubaAdam:
    """Adam on albedo, roughness and the log radiance of the light; what it lacks beside ``two_stage`` is in loop.py."""

    Options: ClassVar[type] = MitsubaAdamOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"smoke": {"steps": 8}, "full": {"steps": 3000}, "paper": {"steps": 35000}}
    info = MethodInfo(
        uses_prior=True,
        paper="W. Jakob et al., Mitsuba 3 renderer, 2022, https://mitsuba-renderer.org",
        deviations=("What is metal in the scene is fitted as a dielectric.",),
    )

    def __init__(self, options: MitsubaAdamOptions) -> None:
        """``options``: see :class:`MitsubaAdamOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam from a constant, or from the prior's albedo. Resumes from the monitor's checkpoint to the same numbers.

        Raises InputError where Mitsuba cannot render.
        """
        import torch

        from ia_bench.methods.asking.sampling import PriorSampler
        from ia_bench.methods.contract import Result
        from ia_bench_baselines.mitsuba_adam.loop import Loop
        from ia_bench_baselines.mitsuba_adam.reconstruction import MitsubaReconstruction

        options, seconds, albedo, counters = self.options, {"prior": 0.0, "loop": 0.0}, None, {"network_calls": 0}
        state = monitor.load()
        if "albedo" in problem.prior.info.provides and options.albedo_weight:
            kept = monitor.kept("prior") if state is not None else None
            if kept is None:
                started = time.perf_counter()
                sampler = PriorSampler(problem, problem.prior, seed, monitor.note)
                kept = {"albedo": sampler.draw(None).values["albedo"], "views": list(sampler.views), "counters": sampler.counters}
                seconds["prior"] = time.perf_counter() - started + sampler.kept_seconds
                monitor.keep("prior", kept)
            albedo, counters = dict(zip(kept["views"], kept["albedo"], strict=True)), kept["counters"]
        problem.gbuffer  # noqa: B018 (made here, the plan as well, and booked as baking)
        started = time.perf_counter()
        loop = Loop(problem, options, albedo=albedo, threads=torch.get_num_threads(), seed=seed)
        seconds["loop"] = time.perf_counter() - started
        if state is not None:
            seconds = dict(state["seconds"])
            loop.restore(state["loop"])
            monitor.note(f"resumed at step {loop.step} of {options.steps}")

        def found() -> MitsubaReconstruction:
            return MitsubaReconstruction(problem.stage, *loop.recovered(), depth=options.depth)

        task, saved = monitor.task("loop", options.steps, loop.step), time.monotonic()
        while loop.step < options.steps:
            started = time.perf_counter()
            loss = loop.advance()
            seconds["loop"] += time.perf_counter() - started
            task.advance(1, loss=loss)
            if loop.step == options.steps:
                break
            if loop.step % FIRST_SCORE == 0 and (loop.step // FIRST_SCORE).bit_count() == 1:
                with problem.costs.exclude("score"):
                    monitor.score("loop", loop.step, sum(seconds.values()), found())
            if monitor.stopping() or time.monotonic() - saved >= options.checkpoint_seconds:
                monitor.save({"loop": loop.state(), "seconds": dict(seconds)})
                saved = time.monotonic()
        started = time.perf_counter()
        recovered = found()
        seconds["loop"] += time.perf_counter() - started
        return Result(recovered, seconds, counters, options.steps)
