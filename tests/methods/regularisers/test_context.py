"""Texels that photographs hardly show follow what is around them; those that they show well stay what they are."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from small_fit import altered, of_two_views

from ia_bench.material.textures import Material, smooth_by_view_count
from ia_bench.methods.contract import FitState, Problem
from ia_bench.methods.regularisers import context
from ia_bench.methods.regularisers.context import Context, effective_view_count
from ia_bench.methods.views import sees
from ia_bench.render.indirect import Atlas

SIDE = 64
PLENTY = 1e6


def test_view_counts_are_cosines_of_the_views_that_see_a_texel(problem: Problem) -> None:
    """Beside rays from the middle of each texel to every camera; pixels are coarser than that, and silhouettes differ."""
    atlas = Atlas.of(problem.stage.mesh, SIDE, problem.device)
    normal, position = problem.stage.surface.geometry(atlas.face.long(), atlas.barycentric)
    cameras = [view.camera for view in problem.scene.train]
    toward = torch.stack([torch.from_numpy(camera.to_world[:3, 3]).float() for camera in cameras]) - position[:, None]
    cosine = (normal[:, None] * toward).sum(-1).clamp_min(0) / toward.norm(dim=-1)
    seen = sees(cameras, position, normal, problem.stage.rays, 1e-3)
    wanted, found = (seen * cosine).sum(1), effective_view_count(problem, SIDE).reshape(-1)[atlas.place]
    often = wanted > 2
    assert often.sum() > 500
    assert abs(float(found.sum() / wanted.sum()) - 1) < 0.1
    assert float((found / wanted)[often].log().abs().median()) < 0.15
    assert float(torch.corrcoef(torch.stack([found, wanted]))[0, 1]) > 0.9


def test_weights_are_those_of_the_formula() -> None:
    """Two by two texels, whose means are the whole coarser texture."""
    texture, count, even = torch.rand(2, 2, 3), torch.tensor([[0.0, 0.1], [0.2, 3.0]]), 0.2
    around = (texture * count[..., None]).sum((0, 1)) / count.sum()
    own = (count**2 / (count**2 + even**2))[..., None]
    torch.testing.assert_close(smooth_by_view_count(texture, count, even), own * texture + (1 - own) * around)


def test_what_is_shown_well_stays_and_the_rest_is_filled() -> None:
    texture, count = torch.rand(32, 32, 2), torch.full((32, 32), PLENTY)
    torch.testing.assert_close(smooth_by_view_count(texture, count, 0.2), texture)
    texture[8:16, 8:16], count[8:16, 8:16] = 100.0, 0.0
    mixed = smooth_by_view_count(texture, count, 0.2)
    assert float(mixed.max()) <= 1
    torch.testing.assert_close(mixed[:, 16:], texture[:, 16:])


@pytest.mark.parametrize("even", [1e-6, 0.2, 1e6])
@pytest.mark.parametrize("least", [0.0, 1e-9, 1.0])
def test_one_colour_stays_that_colour(even: float, least: float) -> None:
    texture = torch.full((48, 48, 3), 0.7)
    count = torch.where(torch.rand(48, 48, generator=torch.Generator().manual_seed(0)) < 0.5, least, 2.0)
    torch.testing.assert_close(smooth_by_view_count(texture, count, even), texture)


def test_with_nothing_shown_it_stays() -> None:
    texture = torch.rand(16, 16, 3)
    assert torch.equal(smooth_by_view_count(texture, torch.zeros(16, 16), 0.2), texture)


def test_noise_where_little_is_shown_goes_and_metal_stays(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = torch.rand(SIDE, SIDE, 4, generator=torch.Generator().manual_seed(0))
    material = Material(noise[..., :3], noise[..., 3:].clamp_min(0.1), torch.ones(SIDE, SIDE, 1))
    count = torch.full((SIDE, SIDE), PLENTY)
    count[:, SIDE // 2 :] = 0.05
    monkeypatch.setattr(context, "effective_view_count", lambda *_: count)
    everywhere = torch.ones(SIDE, SIDE, dtype=torch.bool)
    after = Context().apply(material, FitState(problem, None, None, everywhere, torch.Generator(), None))  # type: ignore[arg-type]
    assert after.metallic is material.metallic
    for name in ("albedo", "roughness"):
        before, mixed = getattr(material, name), getattr(after, name)
        torch.testing.assert_close(mixed[:, : SIDE // 2], before[:, : SIDE // 2], atol=1e-4, rtol=1e-4)
        assert float(mixed[:, SIDE // 2 + 4 :].std()) < 0.3 * float(before[:, SIDE // 2 + 4 :].std())
        assert float(mixed.min()) >= 0
        assert float(mixed.max()) <= 1


def test_a_fit_differs_where_little_is_shown_alone(problem: Problem) -> None:
    plain, mixed = (of_two_views(problem, context={"view_count": count}) for count in (0.0, 0.2))
    few = altered(problem, scene=replace(problem.scene, train=problem.scene.train[:2]))
    vars(few).pop("gbuffer")
    assert torch.equal(plain.light, mixed.light)
    change, count = (
        (plain.material.albedo - mixed.material.albedo).abs().mean(-1),
        effective_view_count(few, len(plain.material.albedo)),
    )
    assert float(change[(count > 0) & (count < 0.1)].mean()) > 3 * float(change[count > 1].mean())
