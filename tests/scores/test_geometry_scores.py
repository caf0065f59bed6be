"""Shapes against shapes whose difference is known: balls of two sizes, a ball that has moved."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene, View
from ia_bench.scores.scorer import score_geometry
from tests.shapes import sphere

CPU = torch.device("cpu")


@pytest.fixture
def views(tiny: Scene) -> list[View]:
    """What the cameras of tiny would see of a ball of radius .5 at the origin."""
    found = []
    for view in tiny.test:
        origin, along = primary_rays(view.camera, 2)
        mask = ((origin**2).sum(-1) - (origin * along).sum(-1) ** 2 < 0.25).mean(-1).astype(np.float32)
        found.append(replace(view, mask=mask))
    return found


def test_a_ball_against_itself_and_a_smaller_one(views: list[View]) -> None:
    scores = score_geometry(Stage(sphere(5, radius=0.5), CPU), sphere(5, radius=0.5), views, 0.5)
    assert scores["normals_degrees"] == 0
    assert (scores["depth"], scores["chamfer"], scores["missed_share"], scores["reasons"]) == (0, 0, 0, {})
    assert scores["mask_iou"] == pytest.approx(1, abs=0.005)
    scores = score_geometry(Stage(sphere(5, radius=0.4), CPU), sphere(5, radius=0.5), views, 0.5)
    diagonal = np.sqrt(3.0)
    assert scores["chamfer"] == pytest.approx(0.1 / diagonal, rel=0.1)
    assert scores["depth"] * diagonal > 0.1  # along rays it is farther than across
    assert scores["mask_iou"] == pytest.approx(0.4**2 / 0.5**2, abs=0.03)
    assert 0.2 < scores["missed_share"] < 1 - 0.4**2 / 0.5**2  # pixels that are covered in part are not missed


def test_of_rays_that_miss_nothing_is_kept_but_that_they_do(views: list[View]) -> None:
    """Most miss, and those of all views are looked at together."""
    stage, asked = Stage(sphere(3, radius=0.4), CPU), list[torch.Tensor]()
    surface = stage.surface
    vars(stage)["surface"] = lambda face, *where: asked.append(face) or surface(face, *where)
    assert score_geometry(stage, sphere(3, radius=0.5), views, 0.5)["depth"] > 0
    assert len(asked) == len(views)
    assert all(bool((face >= 0).all()) for face in asked)


def test_what_lies_beyond_a_photograph_has_no_say_in_silhouettes(views: list[View]) -> None:
    """As where a lens was undone: the mask is 0 there, and nobody knows whether the ball is seen."""
    stage, known = Stage(sphere(5, radius=0.5), CPU), np.ones(views[0].mask.shape, bool)
    known[:, : known.shape[1] // 2] = False
    cropped = [replace(view, mask=view.mask * known, valid=known) for view in views]
    unsaid = [replace(view, valid=None) for view in cropped]
    assert score_geometry(stage, None, cropped, 0.5)["mask_iou"] == pytest.approx(1, abs=0.01)
    assert score_geometry(stage, None, unsaid, 0.5)["mask_iou"] < 0.7
