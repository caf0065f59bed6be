"""A fit's problem as a run makes it, for checks that put another method in the place of ours."""

from __future__ import annotations

from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Prior
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.truth import tell_truth
from ia_bench.scenes.scene import Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer


def make_problem(scene: Scene, prior: Prior, *, shading: str = "eager") -> tuple[Problem, Scorer]:
    """The problem of a scene with truth, on the CPU, and its scorer; ``problem.prior`` is told what it is entitled to.

    Default settings but for direct light and the paper's sum of lobes, which is what the other method has.
    """
    problem = Problem(
        scene.blind(),
        RenderSettings(bounces=0, coat="added", shading=shading),  # type: ignore[arg-type]  # checked where it is used
        make_prior=lambda problem: tell_truth(prior, scene, problem),
        note=lambda _: None,
    )
    return problem, Scorer(scene, Protocol(), problem.device)
