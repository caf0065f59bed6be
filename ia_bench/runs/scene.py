"""The scene of a configuration: its reader made, its files read, what came back checked, and its truth for who may see it.

:class:`ToldPrior` is the one door through which a prior that sees ground truth gets it: every question passes there on its way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import torch

from ia_bench.capture.capture import captured
from ia_bench.common.errors import InputError, PluginError
from ia_bench.common.registry import BUILT_IN, at_work, create, named
from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.corrected import WrappedPrior
from ia_bench.readers.contract import NO_MESH, SceneReader, check_scene, unscored
from ia_bench.render.agreement import check_agreement
from ia_bench.render.renderer import texture_images
from ia_bench.render.stage import Stage
from ia_bench.runs.config import ReaderConfig, RunConfig, SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene, View

SHOWN = (0.02, 2.0)
"""Between these is the mean radiance of the object in photographs that a display shows: neither nearly black nor nearly white."""


def open_scene(scene: SceneConfig, reader: ReaderConfig) -> SceneReader:
    """The reader, made for the scene; nothing is read yet. Raises InputError for one that cannot be used, or is no reader."""
    made = create("reader", reader.name, reader.target, reader.options, resolve_scene_folder(scene, reader))
    if not isinstance(made, SceneReader):
        raise InputError(f"reader={reader.name}: expected a class with read(truth), found {type(made).__name__} without")
    return made


def read_scene(scene: SceneConfig, reader: ReaderConfig, *, truth: bool) -> Scene:
    """The scene, checked. Raises InputError for what is wrong with it; of a reader that is not ours a PluginError that names it."""
    opened = open_scene(scene, reader)
    with at_work("reader", reader.name):
        found = opened.read(truth)
    try:
        return check_scene(found, truth=truth)
    except (InputError, AttributeError, TypeError, ValueError, IndexError) as error:  # all but the first: parts that are no arrays
        if named("reader", reader.name, reader.target).distribution == BUILT_IN:  # which says what is wrong with the files
            raise
        said = error if isinstance(error, InputError) else f"expected what a Scene describes, found other parts ({error})"
        raise PluginError(f"reader={reader.name}: {said}") from error


def captured_scene(config: RunConfig, note: Callable[[str], None]) -> Scene:
    """The scene of a run with its truth, as the run's capture takes it. Raises InputError for what it cannot."""
    return captured(read_scene(config.scene, config.reader, truth=True), config.capture, note)


def tell(scene: Scene, note: Callable[[str], None], *, aligned: bool = True) -> None:
    """Note what the reader mended, whether mesh and images agree, and what cannot be scored. Raises InputError if they do not.

    ``aligned``: whether the protocol aligns albedo to the truth before it is relit.
    """
    for line in scene.notes:
        if not (scene.mesh_is_made and line == NO_MESH):  # which is why one was made
            note(line)
    if scene.mesh is not None:
        check_agreement(scene, note)
    for component, reason in unscored(scene, aligned=aligned).items():
        note(f"{component} will not be scored: {reason}")
    inside = [float(view.image[view.mask > 0.5].mean()) for view in scene.novel if (view.mask > 0.5).any()]
    if inside and not SHOWN[0] <= (mean := sum(inside) / len(inside)) <= SHOWN[1]:
        note(
            f"held-out photographs have a mean radiance of {mean:.3g}, and scores see what a display shows, from black at 0 to "
            "white at 1: multiply photographs and lights by one factor that makes it about .3, or scores of pictures mean little"
        )


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
        chosen, truth = [self._views()[number] for number in observations.views], {}
        for name in self.info.provides:
            if lacking := [view.name for view in chosen if getattr(view, name) is None]:
                raise InputError(f"prior {self.stands_for}: training view {lacking[0]} has no ground-truth {name}")
            truth[name] = torch.from_numpy(np.stack([getattr(view, name) for view in chosen])).float()
        return replace(observations, truth=truth)


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
    """``prior``, such that every question carries the scene's truth, made when it first asks, if it wants that."""
    return ToldPrior(prior, cache(lambda: _true_views(scene, problem))) if "truth" in prior.info.wants else prior
