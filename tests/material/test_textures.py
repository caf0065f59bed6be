"""Texture lookup against scipy and by the written convention; filling of what no pixel saw.

The lookup is a kernel, in float32; the same in torch (benchmarks/reference.py), in float64, is tested beside it.
"""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from benchmarks import reference
from ia_bench.material.textures import fetch, fill_unobserved, smooth_by_view_count, splat

Fetch = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
BY = [pytest.param(fetch, torch.float32, 2e-6, id="kernel"), pytest.param(reference.fetch, torch.float64, 1e-12, id="torch")]


def numbers(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize(("by", "dtype", "close"), BY)
@pytest.mark.parametrize("channels", [1, 2, 3, 5])
@pytest.mark.parametrize(("height", "width"), [(37, 31), (64, 64), (1, 5), (1, 1)])
def test_bilinear_lookup_against_scipy(height: int, width: int, channels: int, by: Fetch, dtype: torch.dtype, close: float) -> None:
    """scipy counts from the centre of texel (0, 0), rows down; UV are drawn beyond the border too.

    A UV in float32 is 6e-8 off, 64 times that in texels, of which neighbours differ by up to 1.
    """
    texture, uv = numbers(height, width, channels), (1.2 * numbers(500, 2, seed=1) - 0.1).to(dtype).double()
    row, column = (1 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5
    expected = [
        map_coordinates(texture[..., c].numpy(), [row.numpy(), column.numpy()], order=1, mode="nearest") for c in range(channels)
    ]
    found = by(texture.to(dtype), uv.to(dtype))
    assert found.dtype == dtype
    np.testing.assert_allclose(found.numpy(), np.stack(expected, -1), rtol=0, atol=close * max(1.0, height / 16))


@pytest.mark.parametrize(("by", "dtype", "close"), BY)
def test_texel_centres_return_the_texel_and_row_0_is_the_top(by: Fetch, dtype: torch.dtype, close: float) -> None:
    texture = numbers(5, 7, 2).to(dtype)
    for row in range(5):
        for column in range(7):
            uv = torch.tensor([[(column + 0.5) / 7, 1 - (row + 0.5) / 5]], dtype=dtype)
            torch.testing.assert_close(by(texture, uv)[0], texture[row, column], rtol=0, atol=close)
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=dtype)
    torch.testing.assert_close(
        by(texture, corners), torch.stack([texture[-1, 0], texture[-1, -1], texture[0, 0], texture[0, -1]]), rtol=0, atol=close
    )


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("threads", [1, 2])
def test_gradient_of_the_kernel(channels: int, threads: int) -> None:
    """It is linear: any step is a finite difference without truncation. And it is the reference's, for many points in a texel."""
    texture, uv = numbers(6, 5, channels).float().requires_grad_(), 1.2 * numbers(5000, 2, seed=3).float() - 0.1
    values = numbers(5000, channels, seed=4).float()
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        (gradient,) = torch.autograd.grad(fetch(texture, uv), texture, values)
    finally:
        torch.set_num_threads(before)
    exact = texture.detach().double().requires_grad_()
    (wanted,) = torch.autograd.grad(reference.fetch(exact, uv.double()), exact, values.double())
    torch.testing.assert_close(gradient.double(), wanted, rtol=1e-5, atol=1e-5 * float(wanted.max()))
    step = numbers(*texture.shape, seed=5).float()
    change = (fetch(texture.detach() + step, uv) - fetch(texture.detach(), uv)).double()
    assert float((change * values).sum()) == pytest.approx(float((gradient.double() * step).sum()), rel=1e-5)


def test_one_value_is_the_mean_of_every_texel_that_it_reaches_however_little() -> None:
    place = (3 + 0.5 + 1e-6) / 16  # a millionth of a texel's width off its middle
    average, weight = splat(torch.tensor([[place, place]]), torch.ones(1, 1), 16)
    assert 0 < weight[weight > 0].min() < 1e-11
    torch.testing.assert_close(average[weight > 0], torch.ones(int((weight > 0).sum()), 1))


def test_what_is_replaced_has_no_say_and_a_count_of_next_to_nothing_is_one() -> None:
    texture, observed = torch.ones(4, 4, 1), torch.zeros(4, 4, dtype=torch.bool)
    observed[0] = True
    assert torch.equal(fill_unobserved(texture.masked_fill(~observed[..., None], torch.nan), observed), texture)
    torch.testing.assert_close(smooth_by_view_count(texture, observed.float(), 1e-30), texture)


def test_splatting_is_the_transpose_of_the_lookup() -> None:
    """<fetch(T), v> = <T, sum of splatted v> for any texture T and values v."""
    texture, uv, values = numbers(16, 16, 3).float(), numbers(200, 2, seed=4).float(), numbers(200, 3, seed=5).float()
    average, weight = splat(uv, values, 16)
    assert float((fetch(texture, uv) * values).sum()) == pytest.approx(
        float((texture * average * weight[..., None]).sum()), rel=1e-5
    )
    assert float(weight.sum()) == pytest.approx(200, rel=1e-5)
    assert (average[weight == 0] == 0).all()
    assert (weight == 0).any()


@pytest.mark.parametrize("size", [1, 2, 8, 13, 64])
def test_filling_leaves_the_observed_and_stays_within_their_range(size: int) -> None:
    texture = numbers(size, size, 3, seed=5)
    observed = numbers(size, size, seed=6) > 0.8
    observed[0, 0] = True
    seen = texture[observed]
    filled = fill_unobserved(torch.where(observed[..., None], texture, 1e6), observed)
    torch.testing.assert_close(filled[observed], seen)
    assert float(filled.min()) >= float(seen.min()) - 1e-9
    assert float(filled.max()) <= float(seen.max()) + 1e-9


def test_filling_takes_the_nearer_of_two_regions_all_or_nothing() -> None:
    """Left border 0, right border 1: what lies between rises from one to the other, the same from both sides."""
    texture, observed = torch.zeros(32, 32, 1), torch.zeros(32, 32, dtype=torch.bool)
    texture[:, -1] = 1
    observed[:, [0, -1]] = True
    filled = fill_unobserved(texture, observed)[..., 0]
    assert (filled[:, :16] < 0.5).all()
    assert (torch.diff(filled, dim=1) > 0).all()
    torch.testing.assert_close(filled, 1 - filled.flip(1), atol=1e-5, rtol=0)
    texture = numbers(8, 8, 3)
    observed = torch.ones(8, 8, dtype=torch.bool)
    assert torch.equal(fill_unobserved(texture, observed), texture)
    assert torch.equal(fill_unobserved(texture, ~observed), texture)
    one = torch.zeros(8, 8, dtype=torch.bool)
    one[3, 5] = True
    torch.testing.assert_close(fill_unobserved(texture, one), texture[3, 5].expand(8, 8, 3))


@pytest.mark.parametrize("size", [64, 65, 96, 100])
def test_filling_and_smoothing_know_no_side(size: int) -> None:
    """A symmetric ramp around a hole; the pyramid's cells begin at one side, which sizes that are no power of two must not show."""
    ramp = torch.linspace(0, 1, size, dtype=torch.float64).expand(size, size)[..., None]
    observed = torch.ones(size, size, dtype=torch.bool)
    hole = slice(size // 2 - 8, -(-size // 2) + 8)
    observed[hole, hole] = False
    for fill in (fill_unobserved, lambda texture, seen: smooth_by_view_count(texture, 4.0 * seen.double(), 0.5)):
        turned = 1 - fill(ramp, observed).flip(1)
        assert float((fill(ramp, observed) - turned).abs().max()) < 0.12
