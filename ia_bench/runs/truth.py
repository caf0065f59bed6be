"""The one door through which a prior that sees ground truth gets it: every question to it passes here on its way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.corrected import WrappedPrior
from ia_bench.render.renderer import texture_images
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene, View


class ToldPrior(WrappedPrior):
    """``prior`` with the truth of ``views()``, all training views, filled in wherever it is asked about some of them."""

    def __init__(self, prior: Prior, views: Callable[[], Sequence[View]]) -> None:
        super().__init__(prior)
        self.stands_for = type(prior).__qualname__  # in messages
        self._views = views

    def shown(self, observations: Observations) -> Observations:
        """The observations with truth, which pictures that are no training views do not have."""
        if observations.views is None:
            return observations
        return replace(observations, truth={name: self._truth(name, observations.views) for name in self.info.provides})

    def _truth(self, component: str, views: tuple[int, ...]) -> Tensor:
        every, images = self._views(), []
        for view in (every[number] for number in views):
            image = getattr(view, component)
            if image is None:
                raise InputError(f"prior {self.stands_for}: training view {view.name} has no ground-truth {component}")
            images.append(image)
        return torch.from_numpy(np.stack(images)).float()


def _true_views(scene: Scene, problem: Problem) -> tuple[View, ...]:
    """The training views with their truth. Where they have no true albedo, it is that of the true texture as they see it."""
    if scene.truth is None or scene.truth.albedo is None or all(view.albedo is not None for view in scene.train):
        return scene.train
    texture = torch.from_numpy(scene.truth.albedo).float().to(problem.device)
    stage, gbuffer = problem.stage, problem.gbuffer
    if scene.truth.mesh is not None:  # to which the texture belongs
        stage = Stage(scene.truth.mesh, problem.device)
        gbuffer = stage.gbuffer([view.camera for view in scene.train], problem.plan.subsamples)
    share = gbuffer.coverage().clamp_min(1e-6)[..., None]
    albedo = (texture_images(stage.surface, gbuffer, texture) / share).cpu().numpy()
    return tuple(
        view if view.albedo is not None else replace(view, albedo=image * view.mask[..., None])
        for view, image in zip(scene.train, albedo, strict=True)
    )


def tell_truth(prior: Prior, scene: Scene, problem: Problem) -> Prior:
    """``prior``, told the truth of the ``scene``, that of the problem, if it wants that; from when it first asks for some."""
    return ToldPrior(prior, cache(lambda: _true_views(scene, problem))) if "truth" in prior.info.wants else prior
