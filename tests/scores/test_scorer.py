"""The renders that are scored, on the smallest shipped scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up import Ball, Gaussian, as_assets
from shapes import camera_at, plate, sphere

from ia_bench.common.paths import scenes_folder
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.readers.native import NativeReader
from ia_bench.render.reconstruction import Quality, Reconstruction, TexturedReconstruction
from ia_bench.render.settings import REFERENCE
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene, Truth, View
from ia_bench.scores import scorer as scorer_module
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.result import Scores
from ia_bench.scores.scorer import Scorer

pytestmark = pytest.mark.usefixtures("mean_square_as_lpips")

CPU = torch.device("cpu")
BALL = Ball()
QUICK = Protocol(name="quick", map_points=2, render_points=1, samples_per_pixel=2)


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where the ball's indirect light is baked, once for all tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IA_BENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr("ia_bench.render.reconstruction.REFERENCE_ATLAS", 32)
        yield


@pytest.fixture(scope="module")
def scene() -> Scene:
    return NativeReader(scenes_folder() / "tiny").read(truth=True)


def scores(scene: Scene, albedo: float) -> Scores:
    """Of a grey object of one albedo under the true light."""
    assert scene.truth is not None
    stage = Stage(scene.mesh, CPU)
    material = Material(torch.full((8, 8, 3), albedo), torch.full((8, 8, 1), 0.5))
    light = torch.from_numpy(scene.truth.lights["train"])
    return Scorer(scene, QUICK, CPU).full(TexturedReconstruction(stage, material, light))


def test_a_novel_light_without_a_map_is_left_out_and_named(scene: Scene) -> None:
    assert scene.truth is not None
    names = sorted({view.light for view in scene.novel} - {"train"})
    assert len(names) >= 2
    unknown = names[0]
    lights = {name: light for name, light in scene.truth.lights.items() if name != unknown}
    whole, part = scores(scene, 0.5), scores(replace(scene, truth=replace(scene.truth, lights=lights)), 0.5)
    key = f"per_image.relighting.{unknown}"
    assert key not in whole.reasons
    assert part.reasons[key] == "left out: the scene has no environment map of this light"
    assert sorted(whole.per_image["relighting"]) == names
    assert part.per_image["relighting"] == {name: whole.per_image["relighting"][name] for name in names[1:]}


def test_without_an_aligned_albedo_relighting_says_why(scene: Scene) -> None:
    black = scores(scene, 0.0)
    assert black.metrics["relighting"]["psnr"] is None
    assert black.reasons["relighting.psnr"] == black.reasons["aligned_albedo.psnr"]
    assert "cannot be aligned" in black.reasons["relighting.psnr"]


# ---- a reconstruction that has no texture ----


SMALL = Protocol(name="small", map_points=3, render_points=3, samples_per_pixel=18)
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


def test_what_a_method_does_not_predict_and_what_a_scene_does_not_know_are_two_reasons(photographed: Scene) -> None:
    scorer = Scorer(photographed, SMALL, CPU)
    dark = scorer.full(replace(BALL, environment=None))
    assert dark.reasons == {
        **{key: value for key, value in scorer.full(BALL).reasons.items() if "view_synthesis" not in key},
        **{f"view_synthesis.{name}": "the method does not predict view synthesis" for name in ("psnr", "ssim", "lpips")},
        "view_synthesis_whole_image.psnr": "the method does not predict view synthesis",
    }
    assert dark.metrics["relighting"] == scorer.full(BALL).metrics["relighting"]
    smooth = scorer.full(replace(BALL, roughness=None))
    assert (smooth.metrics["roughness"]["mse"], smooth.reasons["roughness.mse"]) == (None, "the method does not predict roughness")
    blank = tuple(replace(view, roughness=None) for view in photographed.test)
    unknown = Scorer(replace(photographed, test=blank), SMALL, CPU).full(BALL)
    assert unknown.reasons["roughness.mse"] == "the scene has no true roughness in its test views"
    assert Scorer(photographed, SMALL, CPU).quick(replace(BALL, roughness=None))["roughness_mse"] is None


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
    assert sorted(reference) == sorted(plain.metrics)
    assert 35 < reference["albedo"]["psnr"] < math.inf  # the mesh's own silhouette
    assert 5 < reference["view_synthesis"]["psnr"] < 60  # true shading of a light that the photographs took from the normal
    assert scores.counts["textures"] == {"texels": 16, "roughness_raised": 0}
    textured = TexturedReconstruction.of(exported.assets(), stage)
    assert not any(name.endswith("_reference") for name in Scorer(photographed, SMALL, CPU).full(textured).variants)


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
