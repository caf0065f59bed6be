"""Procedural scenes that are fitted: their light, their textures and their photographs are those that were drawn."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.textures import fetch
from ia_bench.render.stage import Stage
from ia_bench_training.fits.scene import LIGHT_ROWS, PHOTOGRAPHS, ProceduralScene, _mesh, bake, draw_scene, light_map
from ia_bench_training.lights import Light
from ia_bench_training.objects import make_object
from ia_bench_training.textures import draw_materials

SIZE = 24


@pytest.fixture(scope="module")
def drawn() -> ProceduralScene:
    return draw_scene(np.random.default_rng(5), SIZE)


@pytest.mark.parametrize("radius", [0.4, 3.0, 14.0])
def test_a_disc_keeps_its_irradiance_as_texels(radius: float) -> None:
    """Against the closed form: a disc of radiance L and angular radius r gives a surface that faces it pi L sin(r)^2."""
    toward = torch.tensor([[0.48, 0.6, 0.64]])
    edge, emission = math.cos(math.radians(radius)), torch.tensor([[3.0, 2.0, 1.0]])
    light = Light(torch.zeros(64, 128, 3), toward, torch.tensor([edge]), emission)
    texels = light_map(light, LIGHT_ROWS)
    area = row_solid_angles(LIGHT_ROWS, 2 * LIGHT_ROWS).float()[:, None, None]
    cosine = (texel_centres(LIGHT_ROWS, 2 * LIGHT_ROWS) @ toward[0]).clamp_min(0)[..., None]
    found = (texels * cosine * area).sum((0, 1))
    torch.testing.assert_close(found, math.pi * emission[0] * (1 - edge**2), rtol=5e-3, atol=0)


def test_textures_hold_the_materials() -> None:
    """At the middles of large triangles a texture has what the material says there, but for edges of patterns."""
    rng = np.random.default_rng(3)
    solid = make_object(rng)
    materials = draw_materials(rng, solid.slots)
    mesh, faces = _mesh(solid)
    material = bake(solid, faces, mesh, materials)
    corner = torch.from_numpy(mesh.vertices)[torch.from_numpy(mesh.faces).long()]
    area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).norm(dim=-1)
    large = torch.argsort(area)[-200:]
    uv = torch.from_numpy(mesh.uv)[torch.from_numpy(mesh.faces).long()[large]].mean(1)
    face = torch.from_numpy(faces)[large]
    local = torch.from_numpy(solid.local).float()[face].mean(1)
    expected = torch.empty(len(large), 3)
    for number, one in enumerate(materials):
        mine = torch.from_numpy(solid.slot)[face] == number
        if bool(mine.any()):
            expected[mine] = one(local[mine], torch.from_numpy(solid.axis)[face][mine])[0]
    wrong = (fetch(material.albedo, uv) - expected).abs().amax(-1) > 0.05
    assert float(wrong.float().mean()) < 0.15


def test_a_scene_is_a_function_of_its_draws(drawn: ProceduralScene) -> None:
    again = draw_scene(np.random.default_rng(5), SIZE)
    assert np.array_equal(drawn.albedo, again.albedo)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(drawn.scene.train, again.scene.train, strict=True))


def test_photographs_show_the_object(drawn: ProceduralScene) -> None:
    views = drawn.scene.train
    assert len(views) in PHOTOGRAPHS
    assert drawn.scene.metallic is False, "or every fit would look for metal first"
    assert drawn.albedo.shape == (len(views), SIZE, SIZE, 3)
    gbuffer = Stage(drawn.scene.expect_mesh(), torch.device("cpu")).gbuffer([view.camera for view in views], 1)
    hit = _image(gbuffer.coverage())
    for view, albedo, covered in zip(views, drawn.albedo, hit, strict=True):
        assert view.albedo is None
        inside = view.mask == 1
        assert covered[inside].all()
        assert (albedo[inside] >= 0.02 - 1e-4).all()
        assert not albedo[view.mask == 0].any()
        assert not view.image[view.mask == 0].any()
        assert view.image[inside].mean() > 0.01


def _image(values: Tensor) -> np.ndarray:
    return np.asarray(values.numpy() > 0)
