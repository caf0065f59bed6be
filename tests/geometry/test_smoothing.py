"""Heat flow of a sphere, which is known: the Laplacian of the position on a sphere is -2 / radius^2 times the position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ia_bench.geometry.smoothing import smoothed
from tests.shapes import sphere


@pytest.mark.parametrize("width", [0.05, 0.3])
def test_a_sphere_shrinks_as_the_heat_equation_says(width: float) -> None:
    ball = sphere(4, radius=0.8)
    after = np.linalg.norm(smoothed(ball, width).vertices, axis=1)
    expected = 0.8 / (1 + (width / 0.8) ** 2)  # one implicit step of t = width^2 / 2
    np.testing.assert_allclose(after, expected, rtol=2e-3)


def test_bumps_go_before_the_shape() -> None:
    ball = sphere(4)
    random = np.random.default_rng(0)
    rough = replace(ball, vertices=ball.vertices * (1 + 0.02 * random.standard_normal((len(ball.vertices), 1))).astype(np.float32))
    after = np.linalg.norm(smoothed(rough, 0.1).vertices, axis=1)
    assert after.std() < 0.45 * np.linalg.norm(rough.vertices, axis=1).std()
    assert 0.97 < after.mean() < 1


def test_seams_stay_closed_and_texture_coordinates_stay() -> None:
    ball = sphere(2, smooth=False)  # every triangle has corners of its own
    after = smoothed(ball, 0.2)
    np.testing.assert_array_equal(after.uv, ball.uv)
    _, before = np.unique(ball.vertices, axis=0, return_inverse=True)
    for place in range(before.max() + 1):
        assert np.ptp(after.vertices[before.reshape(-1) == place], axis=0).max() == 0
    np.testing.assert_allclose(np.linalg.norm(after.normals, axis=1), 1, atol=1e-5)
