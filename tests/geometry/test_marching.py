"""What rays gather, against the same sums in float64 by torch, whose gradients are autograd's; and against closed forms."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
import torch
from bowls import ball_views, camera_at, directions
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.marching import Rays, gathered, pixels_of
from ia_bench.geometry.warp_march import CHANNELS

SIDE = 14
WIDTH, STRIDE = 3.0, 0.5  # so wide that no part of the rays is skipped, so that both take the same steps


def some_rays(count: int) -> Rays:
    random = torch.Generator().manual_seed(0)
    centre = torch.full((3,), 0.5 * (SIDE - 1))
    origins = centre + 20 * normalize(torch.randn(count, 3, generator=random), dim=-1)
    along = normalize(centre + 5 * (torch.rand(count, 3, generator=random) - 0.5) - origins, dim=-1)
    return Rays(origins, along, torch.full((count,), 14.0), torch.full((count,), 26.0))


def reference(values: Tensor, features: Tensor, rays: Rays) -> tuple[Tensor, Tensor, Tensor]:
    """The sums of the module's docstring over all segments at once, float64."""
    count = int(12 / STRIDE)
    ends = rays.near.double()[:, None] + STRIDE * torch.arange(count + 1, dtype=torch.float64)

    def at(volume: Tensor, travelled: Tensor) -> Tensor:
        places = rays.origins.double()[:, None] + travelled[..., None] * rays.directions.double()[:, None]
        grid = (2 * places / (SIDE - 1) - 1).flip(-1)[None, None]
        return grid_sample(volume[None], grid, align_corners=True, padding_mode="border")[0, :, 0]

    stopped = torch.sigmoid(at(values[None], ends)[0] / WIDTH)
    share = (1 - stopped[:, 1:] / stopped[:, :-1]).clamp_min(0)
    arriving = torch.cumprod(1 - share, 1)
    weight = share * torch.cat([torch.ones_like(arriving[:, :1]), arriving[:, :-1]], 1)
    middle = ends[:, :-1] + 0.5 * STRIDE
    return torch.einsum("nk,cnk->nc", weight, at(features.movedim(-1, 0), middle)), weight.sum(1), (weight * middle).sum(1)


def test_sums_and_gradients_are_those_of_float64() -> None:
    random = torch.Generator().manual_seed(1)
    place = torch.stack(torch.meshgrid(*[torch.arange(SIDE).float()] * 3, indexing="ij"), -1)
    ball = (place - 0.5 * (SIDE - 1)).norm(dim=-1) - 4
    values = (ball + 0.5 * torch.randn(ball.shape, generator=random)).requires_grad_()
    features = torch.randn(*ball.shape, CHANNELS, generator=random).requires_grad_()
    exact = values.detach().double().requires_grad_(), features.detach().double().requires_grad_()
    rays = some_rays(200)
    found, expected = gathered(values, features, rays, WIDTH, STRIDE), reference(*exact, rays)
    worth = [torch.randn(one.shape, generator=random) for one in found]
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other.float(), rtol=1e-3, atol=1e-3)
    sum((a * b).sum() for a, b in zip(found, worth, strict=True)).backward()
    sum((a * b.double()).sum() for a, b in zip(expected, worth, strict=True)).backward()
    for one, other in zip((values, features), exact, strict=True):
        torch.testing.assert_close(one.grad, other.grad.float(), rtol=1e-2, atol=2e-3 * float(other.grad.abs().max()))


def test_nothing_is_kept_of_a_step_that_is_over() -> None:
    """A refinement takes hundreds of steps, each with distances and features of its own."""
    values = torch.linspace(4, -4, SIDE)[:, None, None].expand(SIDE, SIDE, SIDE).contiguous().requires_grad_()
    of_this_step = 1 * values
    gathered(of_this_step, torch.ones(SIDE, SIDE, SIDE, CHANNELS), some_rays(50), 0.3, STRIDE)[1].sum().backward()
    kept = weakref.ref(of_this_step)
    del of_this_step
    gc.collect()
    assert kept() is None


@pytest.mark.parametrize("width", [0.1, 0.4])
def test_a_ray_stops_where_a_plane_is(width: float) -> None:
    """Distances fall from 4 to -9 over 13 cells, so the plane is at 4; rays from far away skip what is empty."""
    values = (4 - torch.arange(SIDE).float())[:, None, None].expand(SIDE, SIDE, SIDE).contiguous()
    features = torch.arange(SIDE).float()[:, None, None, None].expand(SIDE, SIDE, SIDE, CHANNELS).contiguous()
    rays = Rays(torch.tensor([[0.0, 6.3, 6.1]]), torch.tensor([[1.0, 0.0, 0.0]]), torch.zeros(1) + 1e-3, torch.full((1,), 13.0))
    found, opacity, distance = gathered(values, features, rays, width, 0.1)
    assert float(opacity) == pytest.approx(1, abs=5e-3)
    assert float(distance / opacity) == pytest.approx(4, abs=0.06)
    torch.testing.assert_close(found / opacity, distance[:, None].expand(1, CHANNELS) / opacity, atol=1e-3, rtol=0)


def test_pixels_and_their_rays() -> None:
    views = ball_views(3)
    grid = DistanceGrid(torch.zeros(21, 21, 21), torch.full((3,), -1.0), 0.1)
    unknown = replace(views[0], valid=np.tile(np.arange(48) < 24, (48, 1)))
    pixels = pixels_of([unknown, *views[1:]], grid)
    assert int((pixels.mask > 0.5).sum()) == sum(int((view.mask > 0.5).sum()) for view in views)
    assert int(((pixels.view == 0) & (pixels.colour_known == 0) & (pixels.mask_known == 1)).sum()) > 100  # the object, saturated
    assert ((pixels.mask > 0) | (pixels.colour_known == 1) | (pixels.mask_known == 0)).all()
    scene = pixels.rays.origins * grid.step + grid.low
    expected = torch.from_numpy(3 * directions(3)).float()[pixels.view]
    torch.testing.assert_close(scene, expected, atol=1e-4, rtol=0)
    ends = pixels.rays.origins + pixels.rays.far[:, None] * pixels.rays.directions
    assert (ends > -1e-3).all()
    assert (ends < 20 + 1e-3).all()
    camera = camera_at(3 * directions(3)[0])
    assert np.allclose(camera.to_world, views[0].camera.to_world)
