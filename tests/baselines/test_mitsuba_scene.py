"""Mitsuba 3 sees the same scene: orientation of textures, light and cameras, and gradients that belong to our texels."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.mitsuba_scene import TrackedScene
from benchmarks.work_precision.forward import SIDE, ForwardStage
from ia_bench.common.errors import InputError
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.renderer import Renderer, texture_images
from ia_bench_baselines.mitsuba_adam.scene import MitsubaScene, import_mitsuba


@pytest.fixture(scope="module")
def pair() -> tuple[ForwardStage, TrackedScene]:
    stage = ForwardStage("tiny")
    try:
        import_mitsuba(1)
    except InputError as error:
        pytest.skip(str(error))
    return stage, TrackedScene(stage.mesh, [stage.camera], stage.material, stage.light.radiance, threads=1)


def test_images_agree_but_for_the_brdf_and_those_of_albedo_to_rounding(pair: tuple[ForwardStage, TrackedScene]):
    """Correlation over pixels; a texture that is upside down gives 0.7, noise and the other BRDF leave 0.98."""
    stage, scene = pair
    ours = stage.scored(stage.render(Renderer(stage.surface, stage.rays), 128, 0))
    theirs = stage.scored(scene.image(0, 256, 0))
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.95
    assert theirs.mean() == pytest.approx(ours.mean(), rel=0.1)
    ours = texture_images(stage.surface, stage.gbuffer, stage.material.albedo)[0].numpy()
    theirs = np.array(scene.albedo(0))
    assert np.abs(ours - theirs)[stage.inside].max() < 2e-3


def test_a_camera_whose_axis_is_not_in_the_middle_sees_what_ours_does(pair: tuple[ForwardStage, TrackedScene]):
    stage, _ = pair
    middle = stage.camera.centre
    camera = replace(stage.camera, centre=(middle[0] + 3.5, middle[1] - 2.0))
    gbuffer = trace_gbuffer([camera], stage.rays, SIDE, torch.device("cpu"))
    ours = texture_images(stage.surface, gbuffer, stage.material.albedo)[0].numpy()
    theirs = np.array(MitsubaScene(stage.mesh, [camera], stage.material, stage.light.radiance, threads=1).albedo(0))
    inside = (gbuffer.coverage()[0] == 1).numpy()
    assert inside.sum() > 50
    assert np.abs(ours - theirs)[inside].max() < 2e-3
    with pytest.raises(InputError, match="expected square pixels"):
        MitsubaScene(stage.mesh, [replace(camera, focal=(40.0, 50.0))], stage.material, stage.light.radiance, threads=1)


def test_gradients_lie_where_ours_do(pair: tuple[ForwardStage, TrackedScene]):
    """Of the mean radiance: cosine between both gradients, over blocks of texels that hold more than a pixel."""
    stage, scene = pair
    scene.track()
    scene.dr.backward(scene.dr.sum(scene.render(0, 256, 0)))
    scene.evaluate_gradients()
    theirs = scene.gradients()
    leaves = {"albedo": stage.material.albedo.clone().requires_grad_(), "light": stage.light.radiance.clone().requires_grad_()}
    material, light = type(stage.material)(leaves["albedo"], stage.material.roughness), type(stage.light).of(leaves["light"])
    every = torch.arange(len(stage.gbuffer.pixel))
    renderer = Renderer(stage.surface, stage.rays)
    rendered = renderer.render_pixels(stage.gbuffer, every, material, light, 256, torch.Generator().manual_seed(0))
    rendered.radiance.sum().backward()
    for name, leaf in leaves.items():
        assert theirs[name].shape == leaf.grad.shape
        ours, its = (_blocks(gradient) for gradient in (leaf.grad.numpy(), theirs[name]))
        cosine = (ours * its).sum() / np.sqrt(np.square(ours).sum() * np.square(its).sum())
        assert cosine > 0.95, name


def _blocks(texture: np.ndarray, side: int = 8) -> np.ndarray:
    height, width = (length // side for length in texture.shape[:2])
    return texture.reshape(height, side, width, side, -1).sum((1, 3))
