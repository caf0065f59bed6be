"""Which cameras see a point, and the geometry that views show, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from shapes import camera_at, disk, mesh_of, plate, sphere, together
from small_fit import RENDER, scene_of

from ia_bench.methods.contract import Problem
from ia_bench.methods.photographs import cosine_directions, count_views, view_geometry, views_needed
from ia_bench.render.gbuffer import GRAZING, primary_rays, sees
from ia_bench.render.rays import make_rays
from ia_bench.scenes.scene import Camera, Mesh


def problem_of(mesh: Mesh, *cameras: Camera, side: int = 2) -> Problem:
    return Problem(scene_of(mesh, *cameras), replace(RENDER, subsamples=side), note=lambda _: None)


def test_normals_of_a_sphere() -> None:
    """From wherever it is seen, a sphere at the image's middle has the same camera-space normals: the mirror of its rays."""
    cameras = [camera_at(place, pixels=24) for place in ((0.0, -4.0, 0.0), (3.0, 2.0, 1.5), (0.0, 0.0, 4.0))]
    problem = problem_of(sphere(4), *cameras, side=1)
    normals, visibility = view_geometry(problem, (0, 1, 2))
    assert normals.shape == (3, 24, 24, 3)
    assert visibility.shape == (3, 24, 24, 1)
    coverage = problem.gbuffer.coverage()
    for view, camera in enumerate(cameras):
        origins, directions = (array[:, :, 0].astype(np.float64) for array in primary_rays(camera, 1))
        middle = (origins * directions).sum(-1)
        inside = middle**2 - (origins**2).sum(-1) + 1
        closest = np.abs(normals[view].numpy()).sum(-1) > 0
        certain = (inside > 0.02) & closest  # at the very rim the polygons of the mesh decide
        point = origins + (-middle - np.sqrt(inside.clip(0)))[..., None] * directions
        expected = point @ camera.to_world[:3, :3]
        np.testing.assert_allclose(normals[view].numpy()[certain], expected[certain], atol=0.01)
    lengths = normals.norm(dim=-1)
    torch.testing.assert_close(lengths, coverage, rtol=1e-4, atol=1e-5)  # one point a pixel: nothing is averaged
    middle = normals[0, 11:13, 11:13].mean((0, 1))
    torch.testing.assert_close(middle, torch.tensor([0.0, 0.0, 1.0]), rtol=0, atol=0.01)  # toward the camera
    assert float(normals[0, 12, 18, 0]) > 0.3  # x to the right
    assert float(normals[0, 5, 12, 1]) > 0.3  # y up, row 0 is the top


def test_partly_covered_pixels_are_premultiplied() -> None:
    problem = problem_of(sphere(3), camera_at((0.0, -4.0, 0.0), pixels=16))
    normals, visibility = view_geometry(problem, (0,))
    coverage = problem.gbuffer.coverage()[0]
    edge = (coverage > 0) & (coverage < 1)
    assert int(edge.sum()) > 5
    length = normals[0].norm(dim=-1)
    assert bool((length <= coverage + 1e-5).all())
    assert bool((length >= 0.9 * coverage).all())  # the mean of normals that hardly differ within a pixel
    torch.testing.assert_close(visibility[0, ..., 0], coverage, rtol=0, atol=0.05)  # convex: open all around
    assert bool((visibility[0][coverage == 0] == 0).all())


def test_visibility_under_a_lid() -> None:
    """A disk of radius r at height h above a floor hides r^2 / (r^2 + h^2) of the point below its centre."""
    radius, height = 1.0, 0.8
    lid = together(plate(4.0), disk(radius, height=height))
    camera = camera_at((0.0, -3.0, 0.5), pixels=48, field_of_view=8)
    visibility = view_geometry(problem_of(lid, camera), (0,))[1][0, ..., 0]
    # The camera looks under the lid at the origin. 48 x 2 pixels around it, 32 stratified rays each: the standard error is
    # below 0.01 even without stratification; 0.03 leaves room for the pixels' extent.
    found = float(visibility[23:25].mean())
    assert abs(found - (1 - radius**2 / (radius**2 + height**2))) < 0.03


def test_visibility_between_two_facing_walls() -> None:
    """Halfway up between two long walls: the open share of the cosine-weighted hemisphere is a difference of sines."""

    def wall(x: float, facing: float) -> Mesh:
        flat = plate(50.0)
        vertices = np.stack([np.full(4, x), flat.vertices[:, 0], flat.vertices[:, 1].clip(-1, 1)], 1)
        return mesh_of(vertices, flat.faces, normals=np.tile([facing, 0, 0], (4, 1)), uv=flat.uv)

    gap = 1.5
    problem = problem_of(together(wall(0.0, 1.0), wall(gap, -1.0)), camera_at((1.2, 0.001, 0.0), pixels=32, field_of_view=6))
    visibility = view_geometry(problem, (0,))[1][0, ..., 0]
    # A strip that is long in y takes the angles |theta| < atan(1 / gap) of the plane across: (sin - -sin) / 2 is hidden.
    expected = 1 - math.sin(math.atan(1 / gap))
    assert abs(float(visibility.mean()) - expected) < 0.01


def test_directions_follow_the_cosine() -> None:
    """First and second moments of cosine-weighted directions in closed form, around many normals."""
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator), dim=-1)
    normal = torch.cat([normal, torch.eye(3), -torch.eye(3)])
    direction = cosine_directions(normal, torch.rand(len(normal), 20_000, 2, generator=generator))
    assert float((direction * normal[:, None]).sum(-1).min()) >= -1e-6
    # Mean 2/3 n, second moment (I + n n^T) / 4; 5 standard errors of 20000 samples are 0.018 and less.
    torch.testing.assert_close(direction.mean(1), normal * 2 / 3, rtol=0, atol=0.018)
    second = torch.einsum("nki,nkj->nij", direction, direction) / 20_000
    expected = 0.25 * (torch.eye(3) + normal[:, :, None] * normal[:, None])
    torch.testing.assert_close(second, expected, rtol=0, atol=0.018)


def test_a_point_is_seen_from_in_front_and_not_through_a_roof() -> None:
    """A plate of half side 1, and a small one of half side 0.2 half a unit above its middle."""
    mesh = together(plate(1.0), plate(0.2, height=0.5))
    rays = make_rays(mesh, torch.device("cpu"))
    positions = torch.tensor([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [0.0, 0.0, 0.5]])
    up = torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3)
    cameras = [camera_at((0, 0, 5)), camera_at((4, 0, 3)), camera_at((0, 0.1, -5)), camera_at((5, 0, 0.1))]
    expected = torch.tensor(
        [
            [False, True, False, False],  # under the roof: only from the side; from below and at grazing angles not at all
            [True, True, False, False],
            [True, True, False, False],
        ]
    )
    assert torch.equal(sees(cameras, positions, up, rays, 1e-4), expected)


def test_what_lies_outside_the_image_is_not_seen() -> None:
    rays = make_rays(plate(5.0), torch.device("cpu"))
    positions, up = torch.tensor([[0.0, 0, 0], [3.0, 0, 0], [0, 3.0, 0]]), torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3)
    narrow, wide = camera_at((0, 0, 5), field_of_view=30.0), camera_at((0, 0, 5), field_of_view=80.0)
    assert sees([narrow, wide], positions, up, rays, 1e-4).tolist() == [[True, True], [False, True], [False, True]]


def test_photographs_that_show_a_place_of_a_ball() -> None:
    """On the unit sphere those cameras of 40 all around that a place sees at more than the grazing angle."""
    ways = np.random.default_rng(0).normal(size=(40, 3))
    places = 4 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    problem = problem_of(sphere(5), *(camera_at(place, pixels=64) for place in places))
    found = count_views(problem, (0, 7)).numpy()
    gbuffer = problem.gbuffer
    shown = (gbuffer.face[:, 0] >= 0) & torch.isin(gbuffer.view(), torch.tensor([0, 7]))
    _, position = problem.stage.surface.geometry(gbuffer.face[shown, 0].long(), gbuffer.barycentric[shown, 0])
    toward = places[None] - position.numpy()[:, None]
    cosine = (toward * position.numpy()[:, None]).sum(-1) / np.linalg.norm(toward, axis=-1)
    error = found[found > 0] - (cosine > GRAZING).sum(1)
    # A cell is 1.5 degrees wide: the limits of half a camera of 40 run through it.
    assert len(error) > 1500
    assert abs(error).max() <= 4
    assert abs(error).mean() < 0.5
    assert abs(error.mean()) < 0.1


def test_photographs_that_show_either_side_of_a_sheet() -> None:
    above, below = [(0.0, 0.1, 5.0), (1.0, 0.0, 5.0), (0.0, -1.0, 5.0)], [(0.0, 0.1, -5.0), (1.0, 0.0, -5.0)]
    problem = problem_of(plate(0.5), *(camera_at(place, pixels=16) for place in above + below))
    counts = count_views(problem, (0, 3))
    assert [sorted(view.unique().tolist()) for view in counts] == [[0, 3], [0, 2]]


def test_a_view_that_misses_the_object_shows_nothing_of_it() -> None:
    away = replace(camera_at((0.0, 0.0, 5.0), pixels=16), to_world=camera_at((0.0, 0.0, -5.0)).to_world @ np.diag([1.0, 1, -1, 1]))
    problem = problem_of(plate(0.5), camera_at((0.0, 0.1, 5.0), pixels=16), away)
    assert not count_views(problem, (1,)).any()


@pytest.mark.parametrize(("per_point", "share", "expected"), [(1, 1.0, 3), (1, 0.6, 1), (2, 1.0, 4), (9, 1.0, 5)])
def test_views_needed_by_hand(per_point: int, share: float, expected: int) -> None:
    """Three points that five views see; the fourth point is seen by none and does not count."""
    seen = torch.tensor([[1, 0, 0, 1, 0], [1, 1, 0, 0, 1], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]]).bool()
    assert views_needed(seen, per_point, share) == expected
