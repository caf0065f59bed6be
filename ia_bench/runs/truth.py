"""The one door through which a prior that sees ground truth gets it: every question to it passes here on its way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.wrapped import WrappedPrior
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene, View


class ToldPrior(WrappedPrior):
    """``prior`` with the truth of ``views``, all training views, filled in wherever it is asked about some of them."""

    def __init__(self, prior: Prior, views: tuple[View, ...]) -> None:
        super().__init__(prior)
        self.stands_for = type(prior).__qualname__  # in messages
        self._views = views

    def shown(self, observations: Observations) -> Observations:
        """The observations with truth, which pictures that are no training views do not have."""
        if observations.views is None:
            return observations
        return replace(observations, truth={name: self._truth(name, observations.views) for name in self.info.provides})

    def _truth(self, component: str, views: tuple[int, ...]) -> Tensor:
        images = []
        for view in (self._views[number] for number in views):
            image = getattr(view, component)
            if image is None:
                raise InputError(f"prior {self.stands_for}: training view {view.name} has no ground-truth {component}")
            images.append(image)
        return torch.from_numpy(np.stack(images)).float()


def tell_truth(prior: Prior, scene: Scene, surface: SurfaceInterpolator, gbuffer: GBuffer) -> Prior:
    """``prior``, told the truth of the ``scene`` if it wants that; ``gbuffer``: of the training views.

    Where the views have no true albedo, it is that of the true texture as they see it.
    """
    if "truth" not in prior.info.wants:
        return prior
    views = scene.train
    if scene.truth is not None and scene.truth.albedo is not None and any(view.albedo is None for view in views):
        texture = torch.from_numpy(scene.truth.albedo).float().to(surface.device)
        share = gbuffer.coverage().clamp_min(1e-6)[..., None]
        albedo = (texture_images(surface, gbuffer, texture) / share).cpu().numpy()
        views = tuple(
            view if view.albedo is not None else replace(view, albedo=image * view.mask[..., None])
            for view, image in zip(views, albedo, strict=True)
        )
    return ToldPrior(prior, views)
