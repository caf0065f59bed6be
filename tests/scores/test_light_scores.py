"""Light against light: balls under it and its log, against closed forms."""

import math

import numpy as np
import pytest
import torch

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scores.balls import EXPOSURE, SIDE, SIDES, ball_pictures, log_radiance, of_mean_one
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.evaluate import score
from ia_bench.scores.metrics import Undefined
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

ROWS = 64


def light(radiance):
    """The map of a function of unit directions (N, 3) -> (N, 3)."""
    return LatLongEnvironment(radiance(texel_centres(ROWS, 2 * ROWS).reshape(-1, 3)).reshape(ROWS, 2 * ROWS, 3).float())


def sky(directions):
    """1 + z in every channel: its irradiance on a surface of normal n is pi (1 + 2 n_z / 3)."""
    return (1 + directions[:, 2:]).expand(-1, 3)


def coloured(directions):
    return torch.stack([1.5 + directions[:, 0], 1.2 + directions[:, 1], 1.1 + directions[:, 2]], -1)


def predicted(one):
    return Predictions(light=ball_pictures(one), log_light=log_radiance(one))


def test_a_matt_ball_has_the_irradiance_of_the_closed_form():
    pictures = ball_pictures(light(sky))
    line = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    up = np.broadcast_to(-line[:, None], (SIDE, SIDE))
    inside = pictures.coverage[0] > 0
    for matt in pictures.images[2 * SIDES :]:
        assert matt[inside] == pytest.approx(EXPOSURE * (1 + 2 / 3 * up[inside])[:, None].repeat(3, 1), abs=2e-3)


def test_a_mirror_ball_shows_what_lies_behind_the_viewer_and_a_glossy_one_no_more_than_it_receives():
    spot = light(lambda directions: torch.exp(40 * (directions @ torch.tensor([[1.0], [0.0], [0.0]]) - 1)).expand(-1, 3))
    middles = [picture[SIDE // 2, SIDE // 2].mean() for picture in ball_pictures(spot).images[:SIDES]]
    assert middles[0] > 100 * max(middles[1:])
    even = light(lambda directions: torch.ones(len(directions), 3))
    glossy = ball_pictures(even).images[SIDES]
    inside = ball_pictures(even).coverage[SIDES] > 0
    assert (glossy[inside] <= EXPOSURE * 1.01).all()
    assert glossy[SIDE // 2, SIDE // 2] == pytest.approx(EXPOSURE, rel=0.05)  # seen along the normal nearly all of it


def test_the_mean_over_the_sphere_and_the_log_error_of_a_light_that_is_twice_as_bright_on_one_half():
    texels = of_mean_one(light(coloured), 32)
    weights = row_solid_angles(32, 64)[:, None, None] / (4 * math.pi)
    assert float((texels * weights).sum()) / 3 == pytest.approx(1)
    even, half = light(lambda d: torch.ones(len(d), 3)), light(lambda d: 1 + (d[:, 2:] > 0).float().expand(-1, 3))
    found = score(predicted(half), predicted(even), Protocol()).metrics["log_light"]["rmse"]
    assert found == pytest.approx(math.sqrt((math.log(4 / 3) ** 2 + math.log(2 / 3) ** 2) / 2), abs=1e-5)


def test_one_factor_is_free_and_a_colour_is_not():
    true = light(coloured)
    scores = score(predicted(LatLongEnvironment(7 * true.texels)), predicted(true), Protocol())
    assert scores.metrics["log_light"]["rmse"] < 1e-6
    assert scores.metrics["light"]["psnr"] is None or scores.metrics["light"]["psnr"] > 100
    tinted = score(predicted(LatLongEnvironment(true.texels * torch.tensor([1.3, 1.0, 0.8]))), predicted(true), Protocol())
    assert tinted.metrics["light"]["psnr"] < 35
    assert tinted.metrics["log_light"]["rmse"] > 0.1


def test_a_black_light_has_no_score_and_one_that_is_not_recovered_neither():
    black = LatLongEnvironment(torch.zeros(8, 16, 3))
    with pytest.raises(Undefined, match="mean radiance is 0"):
        ball_pictures(black)
    scores = score(Predictions(), predicted(light(sky)), Protocol())
    assert scores.metrics["light"]["psnr"] is None
    assert scores.reasons["light.psnr"] == "the method does not predict light"


def test_a_recovered_light_that_has_no_score_says_why(tiny):
    """Which is not that the method predicts none."""
    material = Material(torch.full((1, 1, 3), 0.5), torch.full((1, 1, 1), 0.5))
    recovered = TexturedReconstruction(Stage(tiny.mesh, torch.device("cpu")), material, torch.zeros(8, 16, 3))
    found = Scorer(tiny, Protocol(samples_per_pixel=1), torch.device("cpu")).full(recovered)
    assert found.metrics["light"]["psnr"] is None
    assert {found.reasons[key] for key in ("light.psnr", "log_light.rmse")} == {"the light's mean radiance is 0"}
    known = score(Predictions(), Predictions(undefined={"light": "the light's mean radiance is 0"}), Protocol())
    assert known.reasons["light.psnr"] == "the light's mean radiance is 0"  # of a true light that is black
