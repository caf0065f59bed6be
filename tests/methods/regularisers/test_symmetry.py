"""What no photograph shows follows what is at the same height and distance from the axis, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from small_fit import of_two_views
from torch import Tensor

from ia_bench.material.textures import Material, fill_unobserved
from ia_bench.methods.contract import FitState, Problem
from ia_bench.methods.regularisers.symmetry import LENGTH, NOISE, SLOPE, Symmetry, around_the_axis, expected
from ia_bench.render.indirect import Atlas

SIDE = 64


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


def completed(problem: Problem, material: Material, observed: Tensor, amount: float) -> Material:
    state = FitState(problem, None, None, observed, torch.Generator().manual_seed(0), None)  # type: ignore[arg-type]
    return Symmetry(amount=amount).apply(material, state)


def filled(problem: Problem, share: float) -> tuple[Material, Material, Tensor, Tensor]:
    true, half, surface = rows_of_paint(problem)
    begun = Material(*(fill_unobserved(texture, half) for texture in (true.albedo, true.roughness)))
    return true, completed(problem, begun, half, share), half, surface & ~half


def test_the_other_side_has_the_paint_of_its_height(problem: Problem) -> None:
    true, guess, half, hidden = filled(problem, 1.0)
    _, kept, _, _ = filled(problem, 0.0)
    for name in ("albedo", "roughness"):
        truth, by_axis, by_neighbours = (getattr(one, name) for one in (true, guess, kept))
        assert torch.equal(by_axis[half], truth[half])
        error, former = (float((one - truth)[hidden].square().mean()) for one in (by_axis, by_neighbours))
        assert error < 0.5 * former


def test_no_share_leaves_what_neighbours_have_brought(problem: Problem) -> None:
    true, kept, half, hidden = filled(problem, 0.0)
    expected_albedo = fill_unobserved(true.albedo, half)
    torch.testing.assert_close(kept.albedo[hidden], expected_albedo[hidden], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("shown", [True, False])
def test_with_all_or_nothing_shown_it_stays(problem: Problem, shown: bool) -> None:
    true, _, _ = rows_of_paint(problem)
    observed = torch.full((SIDE, SIDE), shown)
    assert completed(problem, true, observed, 1.0) is true


def test_expectation_is_that_of_the_formula() -> None:
    """K(x, X) (K(X, X) + noise)^-1 (y - mean), with numpy in float64."""
    random = np.random.default_rng(0)
    shown, elsewhere, values = (random.normal(size=(count, width)) for count, width in ((60, 4), (9, 4), (60, 2)))
    found = expected(*(torch.from_numpy(part).float() for part in (shown, values, elsewhere)))
    covariance = np.exp(-cdist(shown, shown) / LENGTH) + NOISE * np.eye(60)
    mean = values.mean(0)
    wanted = mean + np.exp(-cdist(elsewhere, shown) / LENGTH) @ np.linalg.solve(covariance, values - mean)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_features_stay_where_the_object_is_turned() -> None:
    random = torch.Generator().manual_seed(0)
    position = torch.randn(200, 3, generator=random)
    position = torch.cat([position, position * torch.tensor([-1.0, -1.0, 1.0])])  # so that the axis is in the middle
    normal = torch.nn.functional.normalize(torch.randn(400, 3, generator=random), dim=1)
    turned = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    features = around_the_axis(position, normal)
    torch.testing.assert_close(around_the_axis(position @ turned.T, normal @ turned.T), features)
    torch.testing.assert_close(features[:, 2], SLOPE * normal[:, 2])
    assert not torch.allclose(around_the_axis(position, -normal), features)


def test_a_fit_differs_where_no_photograph_looks_alone(problem: Problem) -> None:
    plain, whole = (of_two_views(problem, symmetry={"amount": share}) for share in (0.0, 1.0))
    assert torch.equal(plain.light, whole.light)
    same = (plain.material.albedo == whole.material.albedo).all(-1)
    assert 0.05 < float(same.float().mean()) < 0.95
