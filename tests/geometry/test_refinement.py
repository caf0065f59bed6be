"""Surfaces from images and masks: a bowl, whose hollow no outline shows, against its closed form."""

from dataclasses import replace

import bowls
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes
from torch.nn.functional import avg_pool2d

from ia_bench.common.errors import InputError
from ia_bench.geometry import refinement
from ia_bench.geometry.grid import DistanceGrid, extracted, normals_at
from ia_bench.geometry.hull import visual_hull
from ia_bench.geometry.refinement import surface_from_images
from ia_bench.geometry.sweep import (
    BLUR,
    FAR,
    PLANES_AT_ONCE,
    WINDOW,
    DepthMap,
    correlation,
    depth_maps,
    fused,
    neighbours,
    redistanced,
    semi_global,
    windowed,
)
from ia_bench.scenes.scene import View

CELLS = 40


@pytest.fixture(scope="module")
def views() -> list[View]:
    return bowls.bowl_views(50, 56, 6.0)


def errors(grid: DistanceGrid) -> tuple[float, float]:
    """Mean distance of the surface from the bowl's, and mean angle between their normals in degrees."""
    vertices, _ = extracted(grid)
    cosine = (normals_at(grid, vertices) * bowls.normal(vertices)).sum(-1)
    return float(np.abs(bowls.distance(vertices)).mean()), float(np.degrees(np.arccos(cosine.clip(-1, 1))).mean())


def depth_of_hollow(grid: DistanceGrid) -> float:
    """Where a line down the bowl's axis meets the surface: 0.1 for a hull, -0.55 for the bowl."""
    heights = torch.linspace(0.5, -0.68, 400)
    outside = grid.at(torch.stack([torch.zeros(400), torch.zeros(400), heights], -1)) > 0
    return float(heights[int((~outside).float().argmax())])


def test_correlation_sees_neither_exposure_nor_offset() -> None:
    random = torch.Generator().manual_seed(0)
    one = torch.rand(3, 12, 13, generator=random)
    other = torch.stack([2.5 * one + 0.3, -one, torch.rand(3, 12, 13, generator=random)])
    found = correlation(one, other)
    torch.testing.assert_close(found[0], torch.ones(12, 13), atol=3e-3, rtol=0)
    torch.testing.assert_close(found[1], -torch.ones(12, 13), atol=3e-3, rtol=0)
    patch, theirs = one[:, 3:8, 4:9].reshape(3, -1).numpy(), other[2, :, 3:8, 4:9].reshape(3, -1).numpy()  # around (5, 6)
    apart, also = patch - patch.mean(1, keepdims=True), theirs - theirs.mean(1, keepdims=True)
    by_hand = (apart * also).sum() / np.sqrt((apart**2).sum() * (also**2).sum())
    assert float(found[2, 5, 6]) == pytest.approx(by_hand, abs=1e-3)


@pytest.mark.parametrize("size", [(12, 13), (3, 7), (1, 1)])
def test_means_over_windows_are_those_of_average_pooling(size: tuple[int, int]) -> None:
    values = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    pooled = avg_pool2d(values, WINDOW, 1, WINDOW // 2, count_include_pad=False)
    torch.testing.assert_close(windowed(values), pooled)


def test_semi_global_costs_of_a_line_are_those_of_the_cheapest_paths() -> None:
    """Of a line of pixels: the least sum of costs and jumps over all choices of the pixels before, less a constant."""
    cost = torch.rand(4, 1, 5, generator=torch.Generator().manual_seed(0))
    found = semi_global(cost, 0.1, 0.25)[:, 0]
    choices = np.stack(np.meshgrid(*[np.arange(4)] * 5, indexing="ij"), -1).reshape(-1, 5)
    jumps = np.abs(np.diff(choices, axis=1))
    paid = cost[choices, 0, np.arange(5)].numpy() + np.pad(np.where(jumps > 1, 0.25, 0.1 * jumps), ((0, 0), (1, 0)))
    last = [paid.sum(1)[choices[:, -1] == k].min() for k in range(4)]  # the way from the left, which ends in the last pixel
    rest = 4 * found[:, -1].numpy() - 3 * cost[:, 0, -1].numpy()  # of the other three ways, it is the first pixel
    assert np.allclose(rest - rest.min(), np.array(last) - min(last), atol=1e-5)


def test_distances_from_triangles() -> None:
    grid = DistanceGrid(torch.zeros(25, 25, 25), torch.full((3,), -1.2), 0.1)
    true = grid.positions().norm(dim=-1) - 0.8
    found = redistanced(DistanceGrid(true.sign() * true.abs().sqrt(), grid.low, grid.step))
    assert (found.values - true).abs()[true.abs() < 0.6].max() < 0.3 * grid.step


def test_depth_maps_of_a_ball_cut_it_out_of_a_cube() -> None:
    """Maps of the exact depth of a ball, with a hull that is far too large."""
    found = bowls.bowl_views(40, 40)
    grid = DistanceGrid(torch.zeros(33, 33, 33), torch.full((3,), -0.8), 0.05)
    cube = DistanceGrid(grid.positions().abs().amax(-1) - 0.7, grid.low, grid.step)
    maps = []
    for view in found:
        rows, columns = np.indices(view.mask.shape) + 0.5
        x = torch.from_numpy((columns - view.camera.centre[0]) / view.camera.focal[0])
        y = torch.from_numpy((rows - view.camera.centre[1]) / view.camera.focal[1])
        length = (1 + x * x + y * y).sqrt()  # of a ray, per unit of depth; the ball is 3 away along the axis
        beside = 9 / length**2 - 9 + 0.6**2
        depth = torch.where(beside > 0, (3 / length - beside.clamp_min(0).sqrt()) / length, 0).float()
        maps.append(DepthMap(view.camera, depth, (depth > 0).float()))
    vertices, _ = extracted(fused(cube, maps))
    near = np.abs(vertices).max(1) < 0.65  # elsewhere no map says anything
    assert near.mean() > 0.9
    assert np.abs(np.linalg.norm(vertices[near], axis=1) - 0.6).mean() < 0.5 * grid.step


@pytest.mark.parametrize("wrong", ["mask", "pose"])
def test_a_photograph_that_shows_nothing_of_the_object_has_no_depths(views: list[View], wrong: str) -> None:
    """Its mask is empty, or its camera looks away."""
    away = replace(views[0].camera, to_world=views[0].camera.to_world @ np.diag([-1.0, 1, -1, 1]))
    empty = replace(views[0], mask=0 * views[0].mask) if wrong == "mask" else replace(views[0], camera=away)
    grid = DistanceGrid(torch.zeros(9, 9, 9), torch.full((3,), -0.8), 0.2)
    first, *others = depth_maps([empty, *(views[near] for near in neighbours(views)[0])], grid)
    assert not first.depth.any()
    assert any(one.depth.any() for one in others)


def test_memory_of_a_sweep_is_that_of_a_few_planes(views: list[View], monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs of phones have millions of pixels: points on all planes through them would take tens of gigabytes."""
    hull, asked, at = visual_hull(views, CELLS), list[int](), DistanceGrid.at
    monkeypatch.setattr(DistanceGrid, "at", lambda grid, points: asked.append(len(points)) or at(grid, points))
    view = views[0]
    assert depth_maps([view, *(views[near] for near in neighbours(views)[0])], hull)[0].depth.any()
    assert max(asked) <= PLANES_AT_ONCE * view.mask.size
    assert sum(asked) > 4 * max(asked)  # there are more of them


def test_a_bowl_is_hollow(views: list[View]) -> None:
    hull = visual_hull(views, CELLS)
    found = surface_from_images(views, CELLS, 20)
    assert depth_of_hollow(hull) > 0
    assert depth_of_hollow(found) < -0.4
    assert errors(found)[1] < 0.55 * errors(hull)[1]


@pytest.mark.slow
def test_a_light_that_turns_is_not_taken_for_paint() -> None:
    """Lamps that go with the camera: measured 5.3 degrees in place of 10 (and 16.7 from the hull, where stereo is left out)."""
    cameras = [bowls.camera_at(3 * direction, side=56) for direction in bowls.directions(50)]
    turns = np.stack([cameras[0].to_world[:3, :3] @ camera.to_world[:3, :3].T for camera in cameras])
    lit = [bowls.bowl_view(number, camera, 6.0, turn) for number, (camera, turn) in enumerate(zip(cameras, turns, strict=True))]
    static, turning = surface_from_images(lit, CELLS, 100), surface_from_images(lit, CELLS, 100, turns=turns)
    assert errors(turning)[1] < 0.7 * errors(static)[1]


def test_of_two_starts_under_a_light_that_turns_the_better_one_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stereo that left a crumb of the ball: the hull, which is right, is nearer to the photographs."""
    balls = bowls.ball_views(20)

    def crumb(hull: DistanceGrid, maps: list[DepthMap]) -> DistanceGrid:
        return DistanceGrid(hull.values + 0.3, hull.low, hull.step)

    monkeypatch.setattr(refinement, "fused", crumb)
    standing = np.stack(20 * [np.eye(3)])
    right = visual_hull(balls, 32)
    misled, chosen = (surface_from_images(balls, 32, 8, turns=turns) for turns in (None, standing))
    assert float((chosen.values - right.values).abs().mean()) < 0.2 * float((misled.values - right.values).abs().mean())


def test_few_or_black_photographs_are_refused(views: list[View]) -> None:
    with pytest.raises(InputError, match="capture.geometry=sdf: expected at least 4 training views, found 3"):
        surface_from_images(views[:3], CELLS, 0)
    with pytest.raises(InputError, match="expected images that show something, found all of them black"):
        surface_from_images([replace(view, image=0 * view.image) for view in views], CELLS, 0)


def test_distances_are_computed_again_near_the_surface_as_everywhere() -> None:
    """Against the nearest point of all for every vertex of the grid."""
    low, side = torch.full((3,), -1.0), 41
    axes = torch.meshgrid(*3 * [torch.linspace(-1, 1, side)], indexing="ij")
    field = (torch.stack(axes, -1) - torch.tensor([0.1, 0.0, 0.2])).norm(dim=-1) ** 3 - 0.05
    vertices, faces, _, _ = marching_cubes(field.numpy(), 0.0)
    surface = np.concatenate([vertices, vertices[faces].mean(1)])
    every = cKDTree(surface).query(np.indices(field.shape).reshape(3, -1).T)[0].clip(max=FAR).reshape(field.shape)
    wanted = gaussian_filter(np.where(field.numpy() < 0, -every, every), BLUR)
    found = redistanced(DistanceGrid(field, low, 2 / (side - 1))).values.numpy() * (side - 1) / 2
    np.testing.assert_allclose(found, wanted, atol=1e-5)
