"""What photographs hardly show follows what is around it, or what is as high and as far from the axis; the rest stays."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from small_fit import of_two_views
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.material.textures import Material, fill_unobserved, smooth_by_view_count
from ia_bench.methods.contract import FitState, Problem
from ia_bench.methods.regularisers import completing
from ia_bench.methods.regularisers.choice import options_for, regularisers_of
from ia_bench.methods.regularisers.completing import LENGTH, NOISE, Context, Symmetry, effective_view_count, expected
from ia_bench.render.gbuffer import sees
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


def test_noise_where_little_is_shown_goes_and_metal_stays(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = torch.rand(SIDE, SIDE, 4, generator=torch.Generator().manual_seed(0))
    material = Material(noise[..., :3], noise[..., 3:].clamp_min(0.1), torch.ones(SIDE, SIDE, 1))
    count = torch.full((SIDE, SIDE), PLENTY)
    count[:, SIDE // 2 :] = 0.05
    monkeypatch.setattr(completing, "effective_view_count", lambda *_: count)
    everywhere = torch.ones(SIDE, SIDE, dtype=torch.bool)
    after = Context().apply(material, FitState(problem, None, None, everywhere, torch.Generator(), None))  # type: ignore[arg-type]
    assert after.metallic is material.metallic
    for name in ("albedo", "roughness"):
        before, mixed = getattr(material, name), getattr(after, name)
        torch.testing.assert_close(mixed[:, : SIDE // 2], before[:, : SIDE // 2], atol=1e-4, rtol=1e-4)
        assert float(mixed[:, SIDE // 2 + 4 :].std()) < 0.3 * float(before[:, SIDE // 2 + 4 :].std())
        assert float(mixed.min()) >= 0
        assert float(mixed.max()) <= 1


def rows_of_paint(problem: Problem) -> tuple[Material, Tensor, Tensor]:
    """Two paints and roughnesses by height on the scene's mesh, the texels of one half of it, and those of all of its surface."""
    atlas = Atlas.of(problem.stage.mesh, SIDE, problem.device)
    _, position = problem.stage.surface.geometry(atlas.face.long(), atlas.barycentric)
    middle = 0.5 * (position.amin(0) + position.amax(0))
    high = (position[:, 2] > middle[2])[:, None]
    albedo, roughness = torch.zeros(SIDE * SIDE, 3), torch.full((SIDE * SIDE, 1), 0.5)
    albedo[atlas.place] = torch.where(high, torch.tensor([0.6, 0.2, 0.1]), torch.tensor([0.1, 0.3, 0.5]))
    roughness[atlas.place] = torch.where(high, 0.2, 0.8)
    half, surface = torch.zeros(SIDE * SIDE, dtype=torch.bool), torch.zeros(SIDE * SIDE, dtype=torch.bool)
    half[atlas.place[position[:, 0] > middle[0]]] = True
    surface[atlas.place] = True
    return (
        Material(albedo.reshape(SIDE, SIDE, 3), roughness.reshape(SIDE, SIDE, 1)),
        half.reshape(SIDE, SIDE),
        surface.reshape(SIDE, SIDE),
    )


def test_the_other_side_has_the_paint_of_its_height(problem: Problem) -> None:
    true, half, surface = rows_of_paint(problem)
    begun = Material(*(fill_unobserved(texture, half) for texture in (true.albedo, true.roughness)))
    state = FitState(problem, None, None, half, torch.Generator().manual_seed(0), None)  # type: ignore[arg-type]
    guess = Symmetry(amount=1.0).apply(begun, state)
    for name in ("albedo", "roughness"):
        truth, by_axis, by_neighbours = (getattr(one, name) for one in (true, guess, begun))
        assert torch.equal(by_axis[half], truth[half])
        error, former = (float((one - truth)[surface & ~half].square().mean()) for one in (by_axis, by_neighbours))
        assert error < 0.5 * former


def test_expectation_is_that_of_the_formula() -> None:
    """K(x, X) (K(X, X) + noise)^-1 (y - mean), with numpy in float64."""
    random = np.random.default_rng(0)
    shown, elsewhere, values = (random.normal(size=(count, width)) for count, width in ((60, 4), (9, 4), (60, 2)))
    found = expected(*(torch.from_numpy(part).float() for part in (shown, values, elsewhere)))
    covariance = np.exp(-cdist(shown, shown) / LENGTH) + NOISE * np.eye(60)
    mean = values.mean(0)
    wanted = mean + np.exp(-cdist(elsewhere, shown) / LENGTH) @ np.linalg.solve(covariance, values - mean)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_context_comes_before_symmetry_and_options_of_a_class_go_by_its_name() -> None:
    with pytest.raises(InputError, match="^fit.regularise: expected context before symmetry, .* found symmetry, parsimony"):
        options_for(["symmetry", "parsimony", "context"], {})
    options_for(["context", "parsimony", "symmetry"], {})
    named = f"{Symmetry.__module__}:Symmetry"
    options_for([named], {"Symmetry": {"amount": 0.25}})
    with pytest.raises(InputError, match="fit.regulariser_options.Symmetry.amount"):
        options_for([named], {"Symmetry": {"amount": 2.0}})
    (made,) = regularisers_of([named], {"Symmetry": {"amount": 0.25}})
    assert made.amount == 0.25


def test_a_fit_differs_where_no_photograph_looks_alone(problem: Problem) -> None:
    plain, whole = (of_two_views(problem, symmetry={"amount": share}) for share in (0.0, 1.0))
    assert torch.equal(plain.light, whole.light)
    same = (plain.material.albedo == whole.material.albedo).all(-1)
    assert 0.05 < float(same.float().mean()) < 0.95
