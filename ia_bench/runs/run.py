"""The whole story of one run: load, reconstruct, score, save."""

from __future__ import annotations

import math
import resource
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import torch
import torch._dynamo  # as the first step of torch's optimisers does: before the clock starts, and for every row

from ia_bench.capture.capture import captured
from ia_bench.capture.capture import record as capture_record
from ia_bench.common.errors import InputError
from ia_bench.common.machine import load, return_memory
from ia_bench.common.progress import Progress, ProgressBar
from ia_bench.common.registry import create
from ia_bench.methods.contract import Method, Monitor, Problem
from ia_bench.methods.couplings.base import coupling_of
from ia_bench.methods.info import AUTO, MethodInfo, held_out
from ia_bench.methods.monitor import CostTracker
from ia_bench.methods.validation import reconstruct
from ia_bench.priors.contract import NoPrior, Prior, PriorInfo
from ia_bench.priors.inputs import beside_run
from ia_bench.priors.validation import check_prior_info
from ia_bench.render.asset_files import glb
from ia_bench.render.reconstruction import Reconstruction
from ia_bench.runs import interruption
from ia_bench.runs.config import RunConfig, method_of
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.pictures.packing import write_bundle
from ia_bench.runs.record import RunRecord, row_seconds
from ia_bench.runs.scene import read_scene, tell, tell_truth
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene
from ia_bench.scores.evaluate import drawn_scale
from ia_bench.scores.scorer import Scorer


def run(config: RunConfig, folder: RunFolder, progress: Progress, known: Mapping[str, Any]) -> RunRecord:
    """Do one run (or finish an interrupted one) and return its record, which is then in ``folder``; ``known``: its labels."""
    # Deterministic algorithms alone, so that the same configuration gives the same numbers; on the CPU. On CUDA nothing is
    # promised: Warp's kernels add by atomics, in any order, and what torch has instead of a bilinear enlargement made fits 1.3 to
    # 1.7 times as long on an H100. torch.use_deterministic_algorithms would do the same, and import torch's compiler.
    torch.set_deterministic_debug_mode("default" if config.device == "cuda" else "error")
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    costs = CostTracker()
    # ---- load ------------------------------------------------------------------------------------------------
    with costs.exclude("capture"):
        scene = read_scene(config.scene, config.reader, truth=True)
        scene = captured(scene, config.capture, progress.note, progress.task)
    tell(scene, progress.note, aligned=config.protocol.alignment != "none")
    method: Method = method_of(config)

    problem = problem_of(config, scene, method.info, note=progress.note, costs=costs)
    if problem.truth is None and "truth" not in problem.prior.info.wants:
        scene = without_training_images(scene, problem.scene)
    return_memory()

    # ---- reconstruct -----------------------------------------------------------------------------------------
    scorer = Scorer(scene, config.protocol, problem.device)
    record = RunMonitor(folder, scorer, costs)
    result = reconstruct(config.method.name, method, problem, seed=config.seed, monitor=record.monitor(progress))
    tell_unused_coupling(config, problem, progress.note)

    # ---- score and save --------------------------------------------------------------------------------------
    counts, cpu_seconds, busy = costs.counts(), costs.cpu_seconds(), load()
    problem.forget_pixels()
    record.score("final", result.steps, sum(result.seconds.values()), lambda: result.reconstruction)
    with costs.exclude("score"):
        scores = scorer.full(result.reconstruction, progress.task)
    write_assets(folder, result.reconstruction)
    with costs.exclude("pictures"):
        scale = drawn_scale(scores.albedo_scales, config.protocol.alignment)
        title = f"{config.scene.name}, {config.row_name}, seed {config.seed}"
        write_bundle(folder, scene, scorer.drawn, scale, title, progress)
    asked = problem.prior.info if method.info.uses_prior else PriorInfo(frozenset())
    time_s = {"bake": 0.0, "prior": 0.0, **result.seconds, **costs.seconds, "total": costs.total()}
    declared = result.declared or asked.declared  # of results that were brought, or of predictions, whose fit takes seconds too
    if result.declared is None and declared is not None and declared.seconds is not None:
        declared = replace(declared, seconds=declared.seconds + row_seconds(time_s))
    found = RunRecord(
        **{**known, **scores.as_dict()},
        config_hash=folder.config_hash,
        status="ok",
        sees_truth=asked.sees_truth or method.info.sees_truth,
        time_s=time_s,
        cpu_seconds=cpu_seconds if config.device == "cpu" else None,
        load=busy,
        peak_memory_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        rays=counts.pop("rays", 0),
        network_calls=result.counters.get("network_calls", 0),
        counters={**counts, **result.counters},
        plan=problem.plan.record() if "plan" in vars(problem) else {"needed": [], "left_out": []},
        capture=capture_record(scene, config.capture),
        declared=declared,
    )
    return folder.write_record(found)


def write_assets(folder: RunFolder, reconstruction: Reconstruction) -> None:
    """Write albedo.exr (T, T, 3), roughness.exr (T, T), light.exr (H, W, 3), all linear, and asset.glb, for other programs.

    And metallic.exr (T, T) where it was recovered. Nothing of a reconstruction that has no textures.
    """
    assets = reconstruction.assets()
    if assets is None:
        return
    for name in ("albedo", "roughness", "metallic", "light"):
        image = getattr(assets, name)
        if image is not None:
            with folder.path_for(f"{name}.exr") as path:
                write_exr(path, image, half=False)
    folder.write_bytes("asset.glb", glb(assets.mesh, assets.albedo, assets.roughness, assets.metallic))


def problem_of(config: RunConfig, scene: Scene, info: MethodInfo, *, note: Callable[[str], None], costs: CostTracker) -> Problem:
    """What a method that says ``info`` of itself is handed of a ``scene``; nothing in it leads to truth that it may not see.

    Raises InputError where the scene lacks what the method needs.
    """
    lacking = info.lacking(scene)
    if lacking:
        raise InputError(f"method={config.method.name}: expected a scene with {' and '.join(lacking)}, found none in {scene.name}")
    if scene.exposures_differ and not (info.fits_exposures or info.sees_truth):
        note(f"every photograph has an exposure of its own; method={config.method.name} takes them for the same")
    if scene.turning is not None and not (info.turns_light or info.sees_truth):
        note(f"the light turns with the camera; method={config.method.name} takes it for one that stands still")
    with costs.exclude("bake"):
        prior: Prior = NoPrior()
        if info.uses_prior:
            with beside_run(config.device):
                prior = create("prior", config.prior.name, config.prior.target, config.prior.options)
            check_prior_info(prior)
    coupling = config.coupling
    return Problem(
        scene.blind(),
        config.render,
        torch.device(config.device),
        # only for a prior that wants it: a closure over the scene is a way to the truth
        make_prior=(lambda problem: tell_truth(prior, scene, problem)) if "truth" in prior.info.wants else (lambda _: prior),
        make_coupling=partial(coupling_of, name=coupling.name, target=coupling.target, options=coupling.options, note=note),
        prior_views=config.prior.views,
        keep_samples=config.prior.cache,
        truth=scene if info.sees_truth else None,
        held_out=held_out(scene) if info.brought else {},
        note=note,
        costs=costs,
    )


def tell_unused_coupling(config: RunConfig, problem: Problem, note: Callable[[str], None]) -> None:
    """Say that a coupling was named which the method, by now done with its fit, has not asked for."""
    if config.coupling.name not in (AUTO, "none") and "coupling" not in vars(problem):
        note(f"coupling={config.coupling.name}: method={config.method.name} has not asked for it; it changed nothing")


def without_training_images(scene: Scene, given: Scene) -> Scene:
    """``scene`` without the truth of its training views, and with the only copy of their images in ``given``, as methods have it.

    Nothing scores or draws training images where there are test views; of 100 large ones each copy is a gigabyte.
    """
    bare = (replace(view, specular=None) for view in scene.train)
    if not scene.test:
        return replace(scene, train=tuple(bare))
    pairs = zip(bare, given.train, strict=True)
    return replace(scene, train=tuple(replace(view, image=other.image, mask=other.mask) for view, other in pairs))


class RunMonitor:
    """What a run keeps in its folder while a method works: error against run time, checkpoints, and accounts."""

    def __init__(self, folder: RunFolder, scorer: Scorer, costs: CostTracker) -> None:
        self._folder, self._scorer, self._costs = folder, scorer, costs
        self._curve: list[dict[str, Any]] = []

    def monitor(self, progress: Progress) -> Monitor:
        """Through which a method reports progress, scores and checkpoints to this folder."""

        def begin(name: str, total: int, done: int = 0) -> ProgressBar:
            self._folder.restoring = False  # a method that goes on has taken over what it loaded
            return progress.task(name, total, done)

        return Monitor(
            begin,
            progress.note,
            self.score,
            self._save,
            self._load,
            interruption.asked,
            elsewhere=lambda: sum(self._costs.seconds.values()),
        )

    def score(self, phase: str, step: int, seconds: float, recovered: Callable[[], Reconstruction]) -> None:
        """Add a row to the curve and write the file."""
        with self._costs.exclude("score"):
            quick = self._scorer.quick(recovered())
            quick = {key: value if value is None or math.isfinite(value) else None for key, value in quick.items()}
            self._curve.append({"stage": phase, "step": step, "seconds": seconds, **quick})
            self._folder.write_curve(self._curve)

    def _save(self, state: dict[str, Any]) -> None:
        self._folder.save_checkpoint({"method": state, "curve": self._curve, "costs": self._costs.state()})

    def _load(self) -> dict[str, Any] | None:
        saved = self._folder.load_checkpoint()
        if saved is None:
            return None
        self._curve = saved["curve"]
        self._costs.restore(saved["costs"])
        return dict(saved["method"])
