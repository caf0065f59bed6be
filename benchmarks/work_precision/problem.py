"""A fit's problem as a run makes it, for checks that put another method in the place of ours."""

from __future__ import annotations

import torch

from ia_bench.methods.contract import Fit, Problem
from ia_bench.methods.plan import make_plan
from ia_bench.priors.contract import Prior
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.runs.truth import tell_truth
from ia_bench.scenes.scene import Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.result import Scores
from ia_bench.scores.scorer import Scorer


class Judge:
    """Scores fits whose two lobes are added, as in the paper."""

    def __init__(self, scene: Scene, stage: Stage) -> None:
        self._scorer, self._stage = Scorer(scene, Protocol(), stage.device), stage

    def quick(self, fit: Fit) -> dict[str, float | None]:
        """See :meth:`ia_bench.scores.scorer.Scorer.quick`."""
        return self._scorer.quick(self._recovered(fit))

    def full(self, fit: Fit) -> Scores:
        """See :meth:`ia_bench.scores.scorer.Scorer.full`."""
        return self._scorer.full(self._recovered(fit))

    def _recovered(self, fit: Fit) -> TexturedReconstruction:
        return TexturedReconstruction(self._stage, fit.material, fit.light, coat="added")


def make_problem(scene: Scene, prior: Prior, *, shading: str = "eager") -> tuple[Problem, Prior, Judge]:
    """Plan, geometry and renderer of a scene with truth, on the CPU, and the prior, told the truth if it wants that.

    Default settings but for direct light and the paper's sum of lobes, which is what the other method has. The problem itself
    holds no truth; the judge does.
    """
    device = torch.device("cpu")
    blind = scene.blind()
    stage = Stage(scene.mesh, device)
    plan = make_plan(blind, stage, RenderSettings(bounces=0, coat="added"), prior)
    gbuffer = stage.gbuffer([view.camera for view in blind.train], plan.subsamples)
    problem = Problem(blind, gbuffer, stage.renderer(shadows=plan.shadows, coat="added", shading=shading), plan)
    return problem, tell_truth(prior, scene, stage.surface, gbuffer), Judge(scene, stage)
