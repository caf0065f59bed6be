"""A small problem over a scene, and a monitor that keeps what a method tells it."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.material.textures import Material
from ia_bench.methods.contract import Coupling, Monitor, Problem
from ia_bench.methods.couplings.targets import Targets
from ia_bench.methods.photographs import restrict
from ia_bench.methods.plan import Plan, make_plan
from ia_bench.methods.two_stage.losses import Losses
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.methods.two_stage.settings import FitSettings, MultigridRates
from ia_bench.priors.contract import NoPrior, Prior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.renderer import texture_images
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.runs.scene import ToldPrior
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Camera, Mesh, Scene, View

RENDER = RenderSettings(
    samples=16, subsamples=2, texture=64, light_height=16, shadows="traced", bounces=0, coat="added", metallic=False
)
TEXELS_ALONE = MultigridRates(albedo=0.0, roughness=0.0, metallic=0.0, light=0.0)
SETTINGS = FitSettings(stage1_steps=20, stage2_steps=10, pixels=256, solve_albedo=False)  # which has tests of its own


def make_problem(scene: Scene) -> Problem:
    """Coupled as in the paper."""
    return Problem(scene, RENDER, make_coupling=lambda _: Targets(), prior_views="all", note=lambda _: None)


def scene_of(mesh: Mesh, *cameras: Camera) -> Scene:
    """A made-up scene, whose photographs are black."""
    blank = [np.zeros((camera.height, camera.width, 3)) for camera in cameras]
    views = (View(str(n), camera, black, 1 + black[..., 0]) for n, (camera, black) in enumerate(zip(cameras, blank, strict=True)))
    return Scene("made-up", "made-up", mesh, tuple(views))


def plan_of(mesh: Mesh, *cameras: Camera, **settings: Any) -> Plan:
    return make_plan(scene_of(mesh, *cameras), Stage(mesh, torch.device("cpu")), RenderSettings(**settings))


def oracle(scene: Scene, **dials: Any) -> ToldPrior:
    return ToldPrior(OraclePrior(**dials), lambda: scene.train)


def altered(problem: Problem, **parts: Any) -> Problem:
    """The same problem with some attributes replaced, those that it makes on demand as well; all others stay as they are."""
    kept = {name: getattr(problem, name) for name in ("stage", "plan", "gbuffer", "renderer")}
    made = {name: parts.pop(name) for name in (*kept, "photographs", "prior") if name in parts}
    changed = replace(problem, **parts)
    vars(changed).update(kept | made)
    return changed


def first_two(problem: Problem) -> Problem:
    """The problem of its first two photographs."""
    scene = replace(problem.scene, train=problem.scene.train[:2])
    return altered(problem, scene=scene, gbuffer=restrict(problem.gbuffer, (0, 1))[0])


def coupled(problem: Problem, coupling: Coupling, **parts: Any) -> Problem:
    return altered(problem, make_coupling=lambda _: coupling, **parts)


def regularised(settings: FitSettings, **options: dict[str, Any]) -> FitSettings:
    """The settings with these regularisers, in this order, each with its options."""
    return replace(settings, regularise=list(options), regulariser_options=options)


def of_two_views(problem: Problem, **options: dict[str, Any]) -> Found:
    """What a short fit without a prior finds from the first two photographs, with regularisers."""
    return fit(first_two(problem), NoPrior(), regularised(replace(SETTINGS, stage1_steps=8, stage2_steps=4), **options), Record())


class Stopped(BaseException):
    """The end of the process."""


def stored(state: object) -> bytes:
    """A state as a file would keep it."""
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


def loaded(state: bytes) -> Any:
    return torch.load(io.BytesIO(state), weights_only=True)


@dataclass
class Record:
    """A monitor's memory: notes, scores as (phase, step, seconds), losses, and every state by the steps that were done."""

    notes: list[str] = field(default_factory=list)
    scores: list[tuple[str, int, float]] = field(default_factory=list)
    states: dict[int, bytes] = field(default_factory=dict)
    losses: list[float] = field(default_factory=list)
    bars: list[str] = field(default_factory=list)
    every: float = 1e9  # seconds between two states
    stop: int = -1  # steps after which the process is told to end

    def monitor(self, resume: bytes | None = None) -> Monitor:
        """A monitor that writes here and hands out the state ``resume``."""

        def task(name: str, steps: int, done: int) -> Any:
            self.bars.append(name)
            return SimpleNamespace(advance=lambda amount=1, **values: self.losses.extend(values.values()))

        def save(state: dict[str, Any]) -> None:
            self.states[len(self.losses)] = stored(state)
            if len(self.losses) == self.stop:
                raise Stopped

        return Monitor(
            task,
            self.notes.append,
            lambda phase, step, seconds, recovered: self.scores.append((phase, step, seconds)),
            save,
            lambda: None if resume is None else loaded(resume),
            lambda: len(self.losses) == self.stop,
            self.every,
        )


@dataclass(frozen=True)
class Found:
    """What a fit found, its reconstruction taken apart."""

    material: Material
    light: Tensor
    seconds: Mapping[str, float]
    counters: Mapping[str, int]
    steps: int


def fit(problem: Problem, prior: Prior, settings: FitSettings, record: Record, seed: int = 0, **resume: bytes) -> Found:
    asked = altered(problem, make_prior=lambda _: prior)
    result = TwoStage(settings).fit(asked, seed=seed, monitor=record.monitor(**resume))
    found = result.reconstruction
    assert isinstance(found, TexturedReconstruction)
    return Found(found.material, found.environment.texels, result.seconds, result.counters, result.steps)


def losses_of(problem: Problem, settings: FitSettings) -> Losses:
    """Those of a fit without a prior."""
    return Losses(problem, settings, PriorLoss(altered(problem, prior=NoPrior()), 0, Monitor.silent()))


def albedo_error(problem: Problem, scene: Scene, albedo: Tensor) -> float:
    """RMS of sRGB albedo over the training views' inner pixels, after one scale for the scene has made means equal."""
    picture = texture_images(problem.renderer.surface, problem.gbuffer, albedo).numpy()
    truth = np.stack([view.albedo for view in scene.train])
    inside = np.stack([view.mask for view in scene.train]) > 0.99
    picture, truth = picture[inside], truth[inside]
    aligned = picture * (truth.mean() / picture.mean())
    return float(np.sqrt(((linear_to_srgb(aligned.clip(0, 1)) - linear_to_srgb(truth)) ** 2).mean()))


def same(a: Found, b: Found) -> bool:
    pairs = (a.material.albedo, b.material.albedo), (a.material.roughness, b.material.roughness), (a.light, b.light)
    return all(torch.equal(x, y) for x, y in pairs)
