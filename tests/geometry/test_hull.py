"""The visual hull of balls, whose outlines and distances are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bowls import ball_views

from ia_bench.common.errors import InputError
from ia_bench.geometry.grid import DistanceGrid, extracted, normals_at
from ia_bench.geometry.hull import outline_distance, visual_hull

RADIUS = 0.7
PIXEL = 3.0 / (48 * 1.2)  # what a pixel of these cameras spans at the ball, scene units


def disc(radius: float, side: int = 64, points: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Coverage of a disc, and the true distance of every pixel's centre from its rim."""
    fine = (np.arange(side * points) + 0.5) / points - side / 2 - 0.3
    inside = np.hypot(fine[:, None], fine[None]) < radius
    centres = np.arange(side) + 0.2 - side / 2
    return inside.reshape(side, points, side, points).mean((1, 3)), np.hypot(centres[:, None], centres[None]) - radius


@pytest.mark.parametrize(("binary", "worst", "typical"), [(False, 0.25, 0.06), (True, 0.6, 0.2)])
def test_outlines_are_found_to_a_fraction_of_a_pixel(binary: bool, worst: float, typical: float) -> None:
    mask, true = disc(19.4)
    found = outline_distance(np.round(mask) if binary else mask)
    near = np.abs(true) < 3
    error = np.abs(found - true)[near]
    assert error.max() < worst
    assert error.mean() < typical


@pytest.mark.parametrize("upright", [False, True])
def test_outlines_of_a_strip_of_one_pixel_are_those_along_it(upright: bool) -> None:
    """Of pixels 8 to 15 of a row, or column, whose outlines lie at 8 and 16."""
    strip = np.zeros((1, 24), np.float32)
    strip[0, 8:16] = 1
    found = outline_distance(strip.T).T if upright else outline_distance(strip)
    np.testing.assert_allclose(found[0], np.abs(np.arange(24) + 0.5 - 12) - 4, atol=0.1)


def test_the_hull_of_a_ball_is_the_ball_from_outside() -> None:
    """Every point of a hull of tangent cones lies outside of the ball, and all but between the tangent circles close to it."""
    grid = visual_hull(ball_views(60), 64)
    vertices, _ = extracted(grid)
    beyond = np.linalg.norm(vertices, axis=1) - RADIUS
    assert beyond.min() > -0.15 * PIXEL
    assert beyond.mean() < 0.35 * PIXEL
    cosine = (normals_at(grid, vertices) * vertices).sum(1) / np.linalg.norm(vertices, axis=1)
    assert np.degrees(np.arccos(cosine.clip(-1, 1))).mean() < 8


def test_what_nobody_knows_carves_nothing() -> None:
    """Views whose right half is missing cut nothing off there; one that sees nothing changes nothing."""
    views = ball_views(30)
    whole = visual_hull(views, 40)
    middle = np.pad(np.ones((2, 2), np.float32), 23)
    blind, empty = (replace(views[0], mask=mask, valid=np.zeros((48, 48), bool)) for mask in (middle, 0 * middle))
    seen = np.tile(np.arange(48) < 24, (48, 1))
    halves = [replace(v, mask=np.where(seen, v.mask, 0), valid=seen) if n % 3 else v for n, v in enumerate(views)]
    points = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=-1) * RADIUS
    for nothing in (blind, empty):
        assert (visual_hull([*views, nothing], 40).at(points) - whole.at(points)).abs().max() < 0.25 * whole.step
    with pytest.raises(InputError, match=r"expected a view whose mask exceeds 0.5 in some pixel, found none among 2$"):
        visual_hull([empty, empty], 40)
    vertices, _ = extracted(visual_hull(halves, 40))
    assert np.linalg.norm(vertices, axis=1).min() > RADIUS - 0.2 * PIXEL
    with pytest.raises(InputError, match="no point that is inside of all"):
        visual_hull([*views, replace(views[0], mask=np.pad(np.ones((3, 3), np.float32), (0, 45)))], 40)


def test_one_wrong_mask_is_survived_where_it_is_tolerated() -> None:
    views = ball_views(40)
    wrong = [replace(views[7], mask=np.pad(np.ones((3, 3), np.float32), (0, 45))), *views[:7], *views[8:]]
    one, none = visual_hull(wrong, 40, tolerated=1), visual_hull(views, 40)
    reach = np.linalg.norm(extracted(one)[0], axis=1)
    assert reach.min() > RADIUS - 0.2 * PIXEL
    assert reach.mean() < RADIUS + 1.5 * PIXEL
    more = visual_hull(views, 40, tolerated=2)
    points = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(0)), dim=-1) * RADIUS
    assert (more.at(points) <= none.at(points) + 0.1 * none.step).all()


@pytest.mark.parametrize(("distance", "far"), [(1e3, False), (1e5, True), (5e6, True)])
def test_map_coordinates_are_refused(distance: float, far: bool) -> None:
    """At 1e5 the surface of the ball is rough by a tenth of a cell, at 5e6 nothing is left of it."""
    views = []
    for view in ball_views(12):
        to_world = view.camera.to_world.astype(float)
        to_world[:3, 3] += distance
        views.append(replace(view, camera=replace(view.camera, to_world=to_world)))
    if far:
        with pytest.raises(InputError, match=r"^masks: expected an object at most 10000 times its size from the origin"):
            visual_hull(views, 24)
    else:
        assert np.linalg.norm(extracted(visual_hull(views, 24))[0] - distance, axis=1).min() > RADIUS - 0.2 * PIXEL


def test_a_thin_part_beside_a_large_one_keeps_its_width() -> None:
    """A wire of one and a quarter pixels beside a disc of 260, few of whose pixels are soft."""
    mask, _ = disc(130.0, side=320)
    fine = (np.arange(320 * 8) + 0.5) / 8
    mask[:, 300:] = ((fine > 309.4) & (fine < 310.65)).reshape(320, 8).mean(1)[300:]
    distance = outline_distance(mask.astype(np.float32))[160, 300:320]
    crossed = np.flatnonzero(np.diff(np.sign(distance)))
    places = [place + distance[place] / (distance[place] - distance[place + 1]) for place in crossed]
    assert places[1] - places[0] == pytest.approx(1.25, abs=0.15)


def test_small_parts_that_every_view_shows_are_kept_and_noise_is_not() -> None:
    axes = torch.meshgrid(*3 * [torch.linspace(-1, 1, 81)], indexing="ij")
    points = torch.stack(axes, -1)

    def ball(radius: float, place: float) -> torch.Tensor:
        return (points - torch.tensor([0.0, 0.0, place])).norm(dim=-1) - radius

    field = torch.minimum(torch.minimum(ball(0.5, -0.2), ball(0.08, 0.7)), ball(0.02, 0.9))
    vertices, _ = extracted(DistanceGrid(field, torch.full((3,), -1.0), 2 / 80))
    assert vertices[:, 2].max() == pytest.approx(0.78, abs=0.01)
