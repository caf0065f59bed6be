"""The renders that are scored, on the smallest shipped scene."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from coarse import COARSE
from made_up import Ball, Gaussian, as_assets
from shapes import camera_at, plate, sphere

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Quality, Reconstruction, TexturedReconstruction
from ia_bench.render.settings import REFERENCE
from ia_bench.render.stage import Stage
from ia_bench.runs.composition import compose
from ia_bench.runs.execute import execute
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Scene, Truth, View
from ia_bench.scenes.turning import TurningLight
from ia_bench.scores import scorer as scorer_module
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

pytestmark = pytest.mark.usefixtures("mean_square_as_lpips", "own_cache")

CPU = torch.device("cpu")
BALL = Ball()


# ---- a reconstruction that has no texture ----
SMALL = Protocol(name="small", map_points=3, render_points=3, samples_per_pixel=18, noise="kept")
VIEWPOINTS = ((2.0, 1.0, 1.5), (-2.0, 1.0, 0.5), (0.0, -2.5, 0.5), (1.0, 2.0, -1.0))


def ball_scene(ball: Ball = BALL, lights: tuple[str, ...] = ("night", "noon")) -> Scene:
    """Photographs of ``ball`` by its own renderer, with everything that a scene may know of it."""
    maps = {name: LatLongEnvironment(Gaussian(sharpness=1.0 + 3 * i).latlong(16)) for i, name in enumerate(lights)}
    cameras = [camera_at(place, pixels=37) for place in VIEWPOINTS]
    seen = ball.maps(cameras, ("albedo", "roughness"), points=SMALL.map_points)

    def views(light: str) -> tuple[View, ...]:
        shot = ball.render(cameras, light=maps.get(light), albedo_scale=None, quality=Quality(SMALL.render_points, 1))
        return tuple(
            View(f"{light}{i}", camera, shot.images[i], shot.coverage[i], light, *(seen[name].images[i] for name in sorted(seen)))
            for i, camera in enumerate(cameras)
        )

    novel = tuple(view for light in ("train", *lights) for view in views(light))
    truth = Truth({name: light.texels.numpy() for name, light in maps.items()})
    return Scene("ball", "made-up", plate(1.0), views("train"), views("train"), novel, truth)


@pytest.fixture(scope="module")
def photographed() -> Scene:
    return ball_scene()


def no_texture(*_: object) -> None:
    raise AssertionError("a reconstruction without textures was asked for some")


def darker_than(ball: Ball) -> Ball:
    return replace(ball, albedo=tuple(0.5 * value for value in ball.albedo))


def test_a_reconstruction_without_textures_is_scored_by_what_it_draws(photographed: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scorer_module, "Stage", no_texture)
    monkeypatch.setattr(scorer_module.TexturedReconstruction, "of", no_texture)
    assert isinstance(BALL, Reconstruction)
    scorer = Scorer(photographed, SMALL, CPU)
    perfect = scorer.full(BALL)
    assert perfect.renderer == perfect.as_dict()["renderer"] == "light along the normal"
    assert [perfect.metrics[name]["psnr"] for name in ("albedo", "aligned_albedo", "view_synthesis")] == [math.inf] * 3
    assert perfect.metrics["relighting"]["psnr"] > 100  # aligned by a factor of 1 but for rounding
    assert perfect.metrics["roughness"]["mse"] == 0
    assert not any(name.endswith("_reference") for name in perfect.variants)
    darker = scorer.full(darker_than(BALL))
    assert darker.metrics["aligned_albedo"]["psnr"] > 100 > darker.metrics["albedo"]["psnr"]
    assert darker.metrics["relighting"]["psnr"] > 100 > darker.metrics["view_synthesis"]["psnr"]
    quick = scorer.quick(darker_than(BALL))
    assert quick["albedo_psnr"] == pytest.approx(darker.per_image["albedo"]["psnr"][0])


def stage_of_the_ball() -> Stage:
    """Of a mesh of BALL, with its texture seen from above."""
    ball = sphere(3)
    return Stage(replace(ball, uv=(0.5 + 0.5 * ball.vertices[:, :2]).astype(np.float32)), CPU)


def test_what_can_be_exported_is_also_drawn_by_the_reference_renderer(photographed: Scene) -> None:
    stage = stage_of_the_ball()
    exported = as_assets(BALL, stage)
    scores = Scorer(photographed, SMALL, CPU).full(exported)
    plain = Scorer(photographed, SMALL, CPU).full(BALL)
    assert {name: scores.metrics[name] for name in scores.metrics} == plain.metrics
    described = scores.as_dict()["protocol_description"]["reference_renderer"]
    assert (scores.renderer, described["name"]) == (BALL.renderer, REFERENCE)
    reference = {name.removesuffix("_reference"): values for name, values in scores.variants.items() if name.endswith("_reference")}
    assert sorted(reference) == sorted(plain.metrics.keys() - {"light", "log_light", "albedo_error"})
    assert 35 < reference["albedo"]["psnr"] < math.inf  # the mesh's own silhouette
    assert 5 < reference["view_synthesis"]["psnr"] < 60  # true shading of a light that the photographs took from the normal
    assert scores.counts["textures"] == {"texels": 16, "roughness_raised": 0}
    textured = TexturedReconstruction.of(exported.assets(), stage)
    assert not any(name.endswith("_reference") for name in Scorer(photographed, SMALL, CPU).full(textured).variants)


def test_a_light_that_turns_is_exported_with_its_turns(photographed: Scene) -> None:
    """A method with a renderer of its own whose light heeds the scene's turns, or stands still."""
    exported = as_assets(BALL, stage_of_the_ball())
    texels = torch.from_numpy(exported.assets().light)
    turning = TurningLight(tuple(map(tuple, photographed.train[0].camera.to_world[:3])))
    scorer, drawn = Scorer(replace(photographed, turning=turning), SMALL, CPU), []
    for given in (turning, None):
        scores = scorer.full(replace(exported, environment=LatLongEnvironment(texels, turning=given)))
        assert scorer.drawn[0].environment.turning == given
        assert scores.counts["textures"]["light_turns"] == (given is not None)
        drawn.append(scores.variants["view_synthesis_reference"]["psnr"])
    assert abs(drawn[0] - drawn[1]) > 0.1


@pytest.mark.parametrize(("method", "turns"), [("ceiling", True), ("constant", False)])
def test_the_light_of_a_run_is_read_back_as_it_was_scored(method: str, turns: bool, tmp_path: Path) -> None:
    words = [f"method={method}", "prior=none", "scene=tiny", "capture.light=camera", "capture.views=2", "device=cpu", "threads=1"]
    execute(compose([*words, *COARSE, f"out={tmp_path / 'run'}"]))
    run = Recovered(tmp_path / "run")
    found = run.reconstruction(Stage(run.read_scene().expect_mesh(), CPU))
    assert (found.environment.turning is not None) == turns == bool(run.record.counts["textures"]["light_turns"])


def test_a_method_that_renders_under_its_own_light_alone_is_relit_by_the_reference_renderer(photographed: Scene) -> None:
    stage = stage_of_the_ball()
    exported = as_assets(BALL, stage)

    class OneLight(type(exported)):
        def render(self, cameras, *, light, albedo_scale, quality):
            drawn = super().render(cameras, light=light, albedo_scale=albedo_scale, quality=quality)
            return drawn if light is None else None

    alone = OneLight(**vars(exported))
    scorer = Scorer(photographed, SMALL, CPU)
    scores = scorer.full(alone)
    assert scores.renderer == f"{BALL.renderer}; under novel lights {REFERENCE}"
    assert scores.metrics["relighting"] == scores.variants["relighting_reference"]
    assert scores.metrics["view_synthesis"] == scorer.full(exported).metrics["view_synthesis"]
    assert scores.metrics["relighting"]["psnr"] is not None
    textured = TexturedReconstruction.of(exported.assets(), stage)
    assert scorer.quick(alone)["relighting_psnr"] == pytest.approx(scorer.quick(textured)["relighting_psnr"], abs=1e-6)


def test_metal_is_scored_where_the_scene_knows_it(photographed: Scene) -> None:
    """A ball that is metal on one side: found, guessed as half metal everywhere, and taken for a dielectric."""
    stage, side = stage_of_the_ball(), 8
    metal = torch.zeros(side, side, 1)
    metal[:, : side // 2] = 1
    albedo, roughness = torch.full((side, side, 3), 0.6), torch.full((side, side, 1), 0.4)
    light = torch.ones(8, 16, 3)
    true, half, none = (
        TexturedReconstruction(stage, Material(albedo, roughness, metallic), light)
        for metallic in (metal, torch.full_like(metal, 0.5), None)
    )
    shown = true.maps([view.camera for view in photographed.test], ["metallic"], points=SMALL.map_points)["metallic"]
    pictures = zip(photographed.test, shown.images, shown.coverage, strict=True)
    views = [replace(view, metallic=each, mask=coverage) for view, each, coverage in pictures]  # edges of the mesh, not of the ball
    scorer = Scorer(replace(photographed, test=tuple(views)), SMALL, CPU)
    assert scorer.full(true).metrics["metallic"]["mse"] == pytest.approx(0, abs=1e-10)
    straight = [each[c > 0.5] / c[c > 0.5] for each, c in zip(shown.images, shown.coverage, strict=True)]
    expected = np.mean([np.mean((values - 0.5) ** 2) for values in straight])
    assert expected > 0.1
    assert scorer.full(half).metrics["metallic"]["mse"] == pytest.approx(expected, rel=1e-5)
    assert scorer.full(none).reasons["metallic.mse"] == "the method does not predict metallic"
    assert "metallic" not in Scorer(photographed, SMALL, CPU).full(true).metrics
