"""A small, eager problem over a scene, and a monitor that keeps what a method tells it."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import torch

from ia_bench.methods.contract import Fit, Monitor, Problem
from ia_bench.methods.plan import Plan
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import Prior
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene

PLAN = Plan(samples=16, subsamples=2, texture=64, light_height=16, shadows="traced")


def make_problem(scene: Scene) -> Problem:
    stage = Stage(scene.mesh, torch.device("cpu"))
    gbuffer = stage.gbuffer([view.camera for view in scene.train], PLAN.subsamples)
    return Problem(scene, gbuffer, stage.renderer(shadows=PLAN.shadows, coat="added"), PLAN)


@dataclass
class Record:
    """A monitor's memory: notes, scores as (stage, step, seconds), and every state by step, as a file would keep it."""

    notes: list[str] = field(default_factory=list)
    scores: list[tuple[str, int, float]] = field(default_factory=list)
    states: dict[int, bytes] = field(default_factory=dict)
    losses: list[float] = field(default_factory=list)

    def monitor(self, resume: bytes | None = None) -> Monitor:
        """A monitor that writes here and hands out the state ``resume``."""

        def save(state: dict[str, Any]) -> None:
            file = io.BytesIO()
            torch.save(state, file)
            self.states[state["step"]] = file.getvalue()

        def load() -> dict[str, Any] | None:
            return None if resume is None else torch.load(io.BytesIO(resume), weights_only=True)

        def score(stage: str, step: int, seconds: float, fit: Fit) -> None:
            self.scores.append((stage, step, seconds))

        record = self

        class Task:
            def advance(self, amount: int = 1, **values: Any) -> None:
                record.losses.append(values["loss"])

        return Monitor(lambda name, total, done: Task(), self.notes.append, score, save, load)


def fit(problem: Problem, prior: Prior, settings: FitSettings, record: Record, seed: int = 0, **resume: bytes) -> Fit:
    return TwoStage().fit(problem, prior, settings, seed=seed, monitor=record.monitor(**resume))


def same(a: Fit, b: Fit) -> bool:
    pairs = (a.material.albedo, b.material.albedo), (a.material.roughness, b.material.roughness), (a.light, b.light)
    return all(torch.equal(x, y) for x, y in pairs)
