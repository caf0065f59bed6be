"""The whole story of one run: load, plan, bake, fit, score, save."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

from ia_bench.common.machine import environment
from ia_bench.common.progress import Progress, Task
from ia_bench.common.registry import create
from ia_bench.methods.asking.border import check_prior_info
from ia_bench.methods.contract import Fit, Monitor, Problem
from ia_bench.methods.plan import make_plan
from ia_bench.render.gbuffer import SurfaceInterpolator
from ia_bench.render.rays import RayCaster
from ia_bench.render.reconstruction import Reconstruction, TexturedReconstruction
from ia_bench.render.shading import choose_shading
from ia_bench.render.stage import Stage
from ia_bench.runs import interruption
from ia_bench.runs.assets import write_assets
from ia_bench.runs.config import RunConfig
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.metrics import SCHEMA
from ia_bench.runs.scene import read_scene, tell
from ia_bench.runs.truth import tell_truth
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer


def run(config: RunConfig, folder: RunFolder, progress: Progress) -> dict[str, Any]:
    """Do one run (or finish an interrupted one) and return its metrics, which are then in ``folder``."""
    # The same configuration gives the same numbers. On CUDA some sums have no deterministic algorithm in torch: there it warns.
    torch.use_deterministic_algorithms(True, warn_only=config.device == "cuda")
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    seconds: dict[str, float] = {}
    started = time.perf_counter()
    # ---- load ------------------------------------------------------------------------------------------------
    device = torch.device(config.device)
    scene = read_scene(config.scene, config.reader, truth=True)
    tell(scene, progress.note)
    scorer = Scorer(scene, Protocol.from_config(config.protocol), device)
    blind = scene.blind()
    prior = create("prior", config.prior.name, config.prior.target, config.prior.options)
    check_prior_info(prior)
    method = create("method", config.method.name, config.method.target, config.method.options)
    if getattr(method, "sees_truth", False):
        method.reveal_scene(scene.truth)

    # ---- plan and bake ---------------------------------------------------------------------------------------
    with _clock(seconds, "bake"):
        stage = Stage(scene.mesh, device, notice=progress.note)
        surface, rays = stage.surface, stage.rays
        plan = make_plan(blind, stage, config.render, prior, prior_views=config.prior.supervision.views)
        for line in plan.lines():
            progress.note(line)
        shading = choose_shading(config.render.shading, progress.note)
        renderer = stage.renderer(shadows=plan.shadows, bounces=plan.bounces, coat=config.render.coat, shading=shading)
        gbuffer = stage.gbuffer([view.camera for view in blind.train], plan.subsamples)
        prior = tell_truth(prior, scene, surface, gbuffer)

    # ---- fit -------------------------------------------------------------------------------------------------

    def recovered(fit: Fit) -> TexturedReconstruction:
        return TexturedReconstruction(stage, fit.material, fit.light, coat=config.render.coat)

    curve = Curve(folder, scorer)
    costs = Costs(rays, surface, started)

    def begin(name: str, total: int, done: int = 0) -> Task:
        folder.restoring = False  # a method that goes on has taken over what it loaded
        return progress.task(name, total, done)

    monitor = Monitor(
        task=begin,
        note=progress.note,
        score=lambda phase, step, spent, fit: curve.score(phase, step, spent, recovered(fit)),
        save=lambda state: folder.save_checkpoint({"fit": state, "curve": curve.rows, "costs": costs.state()}),
        load=lambda: curve.resume(folder.load_checkpoint(), costs),
        stopping=interruption.asked,
        keep=folder.keep,
        kept=folder.kept,
    )
    result: Fit = method.fit(
        Problem(blind, gbuffer, renderer, plan, config.prior.supervision),
        prior,
        config.fit,
        seed=config.seed,
        monitor=monitor,
    )
    seconds.update(result.seconds)

    # ---- score and save --------------------------------------------------------------------------------------
    with _clock(seconds, "score"):
        steps = config.fit.stage1_steps + config.fit.stage2_steps
        curve.score(result.stage, steps, sum(result.seconds.values()), recovered(result))
        scores = scorer.full(recovered(result))
    write_assets(folder, scene.mesh, result)
    metrics = {
        "schema": SCHEMA,
        "row": config.row_name,
        "scene": config.scene.name,
        "seed": config.seed,
        "config_hash": folder.config_hash,
        "status": "ok",
        "sees_truth": bool(prior.info.sees_truth or getattr(method, "sees_truth", False)),
        **scores.as_dict(),
        "time_s": {"bake": 0.0, "prior": 0.0, "stage1": 0.0, "stage2": 0.0, "score": 0.0, **seconds, "total": costs.seconds()},
        "peak_memory_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        "rays": rays.rays,
        "network_calls": result.counters.get("network_calls", 0),
        "counters": {
            "points": surface.points,
            "bent_normals": surface.bent_normals,
            **result.counters,
        },
        "plan": plan.record(),
        "environment": environment(config.device, config.threads or 1),
    }
    return folder.write_metrics(metrics)


@contextmanager
def _clock(seconds: dict[str, float], phase: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[phase] = time.perf_counter() - started


class Costs:
    """What a run has cost so far, that of the processes before an interruption included; what a resumed one repeats counts once."""

    def __init__(self, rays: RayCaster, surface: SurfaceInterpolator, started: float) -> None:
        self._rays, self._surface, self._started = rays, surface, started

    def seconds(self) -> float:
        """Wall time of the whole run."""
        return time.perf_counter() - self._started

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        points, bent = self._surface.points, self._surface.bent_normals
        return {"seconds": self.seconds(), "rays": self._rays.rays, "points": points, "bent_normals": bent}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state`; baking, which a resumed run has just repeated, is in it already."""
        self._started = time.perf_counter() - state["seconds"]
        self._rays.rays = state["rays"]
        self._surface.points, self._surface.bent_normals = state["points"], state["bent_normals"]


class Curve:
    """Error against run time: scored off the clock, kept across interruptions."""

    def __init__(self, folder: RunFolder, scorer: Scorer) -> None:
        self._folder, self._scorer = folder, scorer
        self.rows: list[dict[str, Any]] = []

    def score(self, stage: str, step: int, seconds: float, found: Reconstruction) -> None:
        """Add a row and write the file."""
        quick = self._scorer.quick(found)
        quick = {key: value if value is None or math.isfinite(value) else None for key, value in quick.items()}
        self.rows.append({"stage": stage, "step": step, "seconds": seconds, **quick})
        self._folder.write_curve(self.rows)

    def resume(self, checkpoint: dict[str, Any] | None, costs: Costs) -> dict[str, Any] | None:
        """Take the rows and costs of a checkpoint over and hand on the method's own state."""
        if checkpoint is None:
            return None
        self.rows = checkpoint["curve"]
        costs.restore(checkpoint["costs"])
        state: dict[str, Any] = checkpoint["fit"]
        return state
