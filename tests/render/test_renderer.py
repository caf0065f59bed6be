"""The renderer around the estimator: pictures, what it does not depend on, and Cycles' direct light as a whole."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shapes import camera_at, plate, sphere
from stage import Stage

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.scene import Scene


def test_ground_truth_through_the_renderer_is_cycles_direct_light(tiny: Scene, tiny_folder: Path, tiny_sun: torch.Tensor) -> None:
    """Against direct-only Cycles renders of `tiny`: 32 dB (sRGB, mask) and 7 % of mean radiance, 4 x 4 points a pixel.

    The gap is the Principled BSDF, which takes from the diffuse part what it reflects, noise of both, and the pixel's
    footprint: with 2 x 2 points it is 30 dB, whatever the samples.
    """
    stage = Stage(tiny.mesh, [view.camera for view in tiny.test], side=4)
    albedo, roughness = (torch.from_numpy(t).float() for t in (tiny.truth.albedo, tiny.truth.roughness))
    material = Material(albedo, roughness[..., None].clamp(0.03, 1))
    ours = stage.renderer().render_images(stage.seen, material, SampledLight.of(tiny_sun), 256, torch.Generator().manual_seed(0))
    theirs = np.stack([read_exr(tiny_folder / "direct" / "test" / f"{i:04d}.exr", 4) for i in range(4)])
    mask = theirs[..., 3] > 0.5
    a, b = (linear_to_srgb(image[mask].clip(0, 1)) for image in (ours["radiance"].numpy(), theirs[..., :3]))
    psnr = -10 * np.log10(np.mean((a - b) ** 2))
    assert psnr > 32, f"{psnr:.1f} dB"
    assert ours["radiance"].numpy()[mask].mean() / theirs[..., :3][mask].mean() == pytest.approx(1.0, abs=0.07)
    true_albedo = np.stack([view.albedo for view in tiny.test])
    assert np.abs(ours["albedo"].numpy() - true_albedo)[mask].mean() < 0.02


def test_texture_images_are_box_filtered_and_premultiplied() -> None:
    """A plate with columns of texels, two texels a pixel and four points a pixel, seen from straight above."""
    camera = camera_at((0, 0, 5), pixels=8)
    stage = Stage(plate(5 * np.tan(np.radians(20)) * 6 / 8), [camera], side=2)
    texture = torch.rand(12, 12, 2, generator=torch.Generator().manual_seed(1))
    image = texture_images(stage.surface, stage.seen, texture)
    assert image.shape == (1, 8, 8, 2)
    expected = torch.zeros(8, 8, 2)
    expected[1:7, 1:7] = texture.reshape(6, 2, 6, 2, 2).mean((1, 3))
    torch.testing.assert_close(image[0], expected, atol=1e-3, rtol=0)


def test_the_same_generator_gives_the_same_picture(tiny_stage: Stage, tiny_material: Material, soft_light: torch.Tensor) -> None:
    def once(seed: int) -> torch.Tensor:
        light, rng = SampledLight.of(soft_light), torch.Generator().manual_seed(seed)
        return tiny_stage.renderer().render_images(tiny_stage.seen, tiny_material, light, 32, rng)["radiance"]

    assert torch.equal(once(1), once(1))
    assert not torch.equal(once(1), once(2))


def test_without_shadows_a_convex_mesh_is_the_same_to_the_last_bit() -> None:
    """With flat triangles a direction above the surface never meets it again."""
    stage = Stage(sphere(2, smooth=False), [camera_at((2.0, 1.0, 1.5))])
    light = SampledLight.of(torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1)))
    grey = Material(torch.full((2, 2, 3), 0.5), torch.full((2, 2, 1), 0.5))
    traced, none = (stage.estimate(stage.every, grey, light, 256, shadows=shadows) for shadows in ("traced", "none"))
    assert stage.rays.rays > 10_000
    assert torch.equal(traced.radiance, none.radiance)


@pytest.mark.parametrize("sizes", [0.0, 1e3, 0.9e4])
def test_a_convex_mesh_throws_no_shadow_on_itself_as_far_from_the_origin_as_meshes_may_lie(sizes: float) -> None:
    """Its corners are rounded there, and flat triangles that should be level meet at edges a little higher or lower."""
    mesh, camera = sphere(2), camera_at((2.0, 1.0, 1.5))
    place = sizes * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    to_world = camera.to_world.copy()
    to_world[0, 3] += place
    mesh = replace(mesh, vertices=(mesh.vertices + np.array([place, 0, 0])).astype(np.float32))
    stage, grey = Stage(mesh, [replace(camera, to_world=to_world)]), Material(torch.full((2, 2, 3), 0.5), torch.ones(2, 2, 1))
    traced, none = (
        stage.estimate(stage.every, grey, SampledLight.of(torch.ones(8, 16, 3)), 64, shadows=shadows).diffuse.mean()
        for shadows in ("traced", "none")
    )
    assert float(traced) == pytest.approx(float(none), rel=0.01)


def test_points_that_miss_count_as_nothing() -> None:
    """At half covered pixels the radiance is half that of the plate's inside."""
    camera = camera_at((0, 0, 5), pixels=12)
    stage = Stage(plate(5 * np.tan(np.radians(20)) * 7 / 12), [camera], side=2)
    material = Material(torch.full((2, 2, 3), 0.5), torch.ones(2, 2, 1))
    images = stage.renderer().render_images(
        stage.seen, material, SampledLight.of(torch.ones(8, 16, 3)), 512, torch.Generator().manual_seed(3)
    )
    assert float(images["diffuse"][0, 4:8, 4:8].mean()) == pytest.approx(0.5, rel=0.02)
    assert float(images["diffuse"][0, 2, 3:9].mean()) == pytest.approx(0.25, rel=0.05)
    assert float(images["radiance"][0, 0].max()) == 0


# ---------------------------------------------------------------- mistakes and layouts
@pytest.mark.parametrize(
    ("shape", "where", "wanted"),
    [
        ((4, 4), 1, "(T, T, 1), found (4, 4)"),  # roughness without its last axis
        ((4, 4, 3), 1, "(T, T, 1), found (4, 4, 3)"),
        ((4, 4, 4), 0, "(T, T, 3), found (4, 4, 4)"),
        ((8, 4, 3), 0, "(T, T, 3), found (8, 4, 3)"),  # more rows than columns: beyond the end of the memory
        ((4, 8, 1), 2, "(T, T, 1), found (4, 8, 1)"),
    ],
)
def test_textures_of_another_shape_are_refused(shape: tuple[int, ...], where: int, wanted: str) -> None:
    stage = Stage(sphere(2), [camera_at((2.0, 1.0, 1.5), pixels=16)])
    textures = [torch.zeros(4, 4, 3), torch.full((4, 4, 1), 0.5), torch.zeros(4, 4, 1)]
    textures[where] = torch.full(shape, 0.5)
    with pytest.raises(ValueError, match=re.escape(wanted)):
        stage.estimate(torch.arange(3), Material(*textures), SampledLight.of(torch.ones(2, 4, 3)), 4)
