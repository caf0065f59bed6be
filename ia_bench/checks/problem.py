"""A fit's problem as a run makes it, for checks that put another method in the place of ours."""

from __future__ import annotations

import torch

from ia_bench.methods.contract import Problem
from ia_bench.methods.plan import make_plan
from ia_bench.priors.contract import Prior
from ia_bench.priors.oracle import OraclePrior
from ia_bench.render.gbuffer import SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import make_rays
from ia_bench.render.renderer import Renderer
from ia_bench.render.settings import RenderSettings
from ia_bench.render.visibility import make_visibility
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
    blind = scene.for_training()
    surface, rays = SurfaceInterpolator(scene.mesh, device), make_rays(scene.mesh, device)
    plan = make_plan(blind, surface, rays, RenderSettings(bounces=0, coat="added"), prior, device)
    gbuffer = trace_gbuffer([view.camera for view in blind.train], rays, plan.subsamples, device)
    if isinstance(prior, OraclePrior):
        prior.reveal(with_albedo(scene, surface, gbuffer))
    shadows = make_visibility(plan.shadows, scene.mesh, surface, rays)
    problem = Problem(blind, gbuffer, Renderer(surface, shadows, shading=shading), plan)
    return problem, Scorer(scene, Renderer(surface, shadows), rays, Protocol(), seed=0)
