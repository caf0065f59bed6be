"""Images on their way to the networks and back: placement, encoding and edges by hand, round trips to a known accuracy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.priors.original import Crop, decode, encode

SIDE = 64


def disc(height: int, width: int, row: float, column: float, radii: tuple[float, float]) -> Tensor:
    """Coverage of an ellipse with an antialiased edge of about one pixel."""
    rows, columns = np.mgrid[:height, :width]
    distance = np.hypot((rows - row) / radii[0], (columns - column) / radii[1])
    return torch.from_numpy(np.clip((1 - distance) * min(radii) + 0.5, 0, 1).astype(np.float32))


def smooth_image(mask: Tensor) -> Tensor:
    """A premultiplied picture whose colours change slowly, within [0.2, 0.8]."""
    height, width = mask.shape
    rows, columns = torch.meshgrid(torch.arange(height) / height, torch.arange(width) / width, indexing="ij")
    colour = torch.stack([0.5 + 0.3 * torch.sin(3 * rows), 0.5 + 0.3 * torch.cos(2 * columns), 0.3 + 0.4 * rows * columns], -1)
    return colour * mask[..., None]


def test_crop_fills_the_longer_side_and_centres_the_shorter() -> None:
    mask = torch.zeros(20, 40)
    mask[3:9, 10:34] = 1  # 6 x 24
    mask[0, 0] = 0.5  # not more than half covered
    crop = Crop.of(mask, 48)
    assert crop == Crop(slice(3, 9), slice(10, 34), slice(18, 30), slice(0, 48))
    thin = torch.zeros(200, 3)
    thin[:, 1] = 1
    assert Crop.of(thin, 48) == Crop(slice(0, 200), slice(1, 2), slice(0, 48), slice(24, 25))  # round(23.5) = 24
    assert Crop.of(torch.full((4, 4), 0.5), 48) is None


def test_encoding_is_gamma_on_white() -> None:
    """At the networks' own size nothing is resampled, so every pixel follows from the definition."""
    mask = torch.ones(SIDE, SIDE)
    mask[10, 20], mask[11, 20], mask[12, 20] = 0.0, 0.4, 0.75
    colour = torch.rand(SIDE, SIDE, 3, generator=torch.Generator().manual_seed(0)) * 1.5  # up to 1.5: clipped
    image = colour * mask[..., None]
    square = encode(image, mask, Crop.of(mask, SIDE), SIDE)
    expected = colour.double().clamp(0, 1) ** (1 / 2.2)
    expected[10:12, 20] = 1  # half or less covered: white
    np.testing.assert_allclose(square.movedim(0, -1), expected, atol=1e-6)


@pytest.mark.parametrize("size", [(37, 31), (96, 64), (300, 411)])
def test_round_trip_keeps_a_smooth_object(size: tuple[int, int]) -> None:
    """Away from the silhouette, where white bleeds in, resampling a slow picture loses less than half a percent."""
    height, width = size
    mask = disc(height, width, 0.5 * height, 0.45 * width, (0.35 * height, 0.3 * width))
    image, crop = smooth_image(mask), Crop.of(mask, SIDE)
    back = decode(encode(image, mask, crop, SIDE), mask, crop)
    assert back.dtype == torch.float32
    assert bool((back[mask == 0] == 0).all())
    assert bool((back <= mask[..., None]).all())
    inner = disc(height, width, 0.5 * height, 0.45 * width, (0.27 * height, 0.22 * width)) == 1
    assert float((back - image)[inner].abs().max()) < 5e-3


def test_round_trip_at_the_own_size_is_exact_up_to_the_edge() -> None:
    mask = disc(SIDE, SIDE, 31.5, 31.5, (32.5, 32.5))
    image, crop = smooth_image(mask), Crop.of(mask, SIDE)
    back = decode(encode(image, mask, crop, SIDE), mask, crop)
    covered = mask > 0.5
    np.testing.assert_allclose(back[covered], image[covered], atol=1e-6)
    edge = (mask > 0) & ~covered
    assert bool(edge.any())
    neighbour = (back / mask[..., None])[edge]  # a colour of the object, not the white that the network saw there
    assert float(neighbour.max()) < 0.85
