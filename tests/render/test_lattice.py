"""The lattice that the samples of a pixel are taken from; that the kernels take the same: test_kernels.py."""

from __future__ import annotations

import math

import pytest
import torch

from ia_bench.render.lattice import lattice

pytestmark = pytest.mark.verify


@pytest.mark.parametrize(("points", "count"), [(1, 16), (4, 8), (9, 3)])
def test_lattice_is_uniform_and_stratified(points: int, count: int) -> None:
    """Over random rotations every entry is uniform; in each pixel the first coordinate has one entry per stratum."""
    rotation = torch.rand(4000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    samples = lattice(rotation, points, count)
    assert samples.shape == (4000, points, count, 3)
    assert 0 <= float(samples.min()) <= float(samples.max()) < 1
    assert float(samples.float().max()) < 1
    strata = (samples[..., 0].reshape(4000, -1) * points * count).long().sort(dim=1).values
    assert torch.equal(strata, torch.arange(points * count).expand(4000, -1))
    deviation = samples.mean(0) - 0.5  # of 4000 uniform numbers: sigma = 1 / sqrt(12 * 4000)
    assert float(deviation.abs().max()) < 5 / math.sqrt(12 * 4000)
    if count > 1:  # each point of the pixel alone spans the whole range
        spread = samples[..., 0].amax(2) - samples[..., 0].amin(2)
        assert float(spread.min()) > 1 - 2 / count
