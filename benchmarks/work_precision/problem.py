"""A fit's problem as a run makes it, for checks that put another method in the place of ours."""

from __future__ import annotations

import torch

from ia_bench.methods.contract import Problem
from ia_bench.methods.plan import make_plan
from ia_bench.priors.contract import Prior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.runs.run import with_albedo
from ia_bench.scenes.scene import Scene
from ia_bench.scores.predict import Scorer
from ia_bench.scores.protocol import Protocol


def make_problem(scene: Scene, prior: Prior, *, shading: str = "eager") -> tuple[Problem, Scorer]:
    """Plan, geometry and renderer of a scene with truth, on the CPU; the oracle is given its truth.

    Default settings but for direct light and the paper's sum of lobes, which is what the other method has. The problem itself
    holds no truth; the scorer does, and renders with its own (eager) renderer.
    """
    device = torch.device("cpu")
    blind = scene.blind()
    stage = Stage(scene.mesh, device)
    plan = make_plan(blind, stage.surface, stage.rays, RenderSettings(bounces=0, coat="added"), prior, device)
    gbuffer = stage.gbuffer([view.camera for view in blind.train], plan.subsamples)
    if isinstance(prior, OraclePrior):
        prior.reveal(with_albedo(scene, stage.surface, gbuffer))
    problem = Problem(blind, gbuffer, stage.renderer(shadows=plan.shadows, coat="added", shading=shading), plan)
    return problem, Scorer(scene, stage.renderer(shadows=plan.shadows, coat="added"), stage.rays, Protocol(), seed=0)
