"""Pearson's chi-square test of counts against expected counts, with small cells pooled."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

FALSE_ALARM = 1e-4
"""Probability that one test of a correct sampler fails. Seeds are fixed, so that it fails always or never."""

SMALLEST_EXPECTED = 5.0


def assert_frequencies(observed: np.ndarray, expected: np.ndarray) -> None:
    """Assert that ``observed`` counts could have come from ``expected`` ones (same total, up to quadrature error).

    Cells are pooled in order of their expected count until each pool expects SMALLEST_EXPECTED. A pool that expects
    (almost) nothing must be (almost) empty: it is joined with its neighbour, never dropped.
    """
    observed, expected = np.asarray(observed, np.float64).ravel(), np.asarray(expected, np.float64).ravel()
    assert abs(expected.sum() / observed.sum() - 1) < 1e-3, (
        f"expected {expected.sum():g} samples, drew {observed.sum():g}"
    )
    expected = expected * observed.sum() / expected.sum()
    order = np.argsort(expected)
    pools, pool = [], np.zeros(2)
    for cell in order:
        pool = pool + (observed[cell], expected[cell])
        if pool[1] >= SMALLEST_EXPECTED:
            pools.append(pool)
            pool = np.zeros(2)
    if pools:
        pools[-1] = pools[-1] + pool
    counts = np.array(pools)
    if len(counts) < 2:  # one cell takes all: nothing is random
        assert len(counts) == 1
        assert counts[0, 0] == observed.sum()
        return
    statistic = float(((counts[:, 0] - counts[:, 1]) ** 2 / counts[:, 1]).sum())
    probability = float(chi2.sf(statistic, len(counts) - 1))
    assert probability > FALSE_ALARM, (
        f"chi-square {statistic:.1f} on {len(counts) - 1} degrees of freedom, p = {probability:.2g}"
    )
