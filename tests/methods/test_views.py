"""Which cameras see a point, against geometry that can be told by hand."""

from __future__ import annotations

import pytest
import torch
from shapes import camera_at, plate, together

from ia_bench.methods.views import sees, views_needed
from ia_bench.render.rays import make_rays


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


@pytest.mark.parametrize(("per_point", "share", "expected"), [(1, 1.0, 3), (1, 0.6, 1), (2, 1.0, 4), (9, 1.0, 5)])
def test_views_needed_by_hand(per_point: int, share: float, expected: int) -> None:
    """Three points that five views see; the fourth point is seen by none and does not count."""
    seen = torch.tensor([[1, 0, 0, 1, 0], [1, 1, 0, 0, 1], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]]).bool()
    assert views_needed(seen, per_point, share) == expected
