"""Pearson's chi-square test of counts against expected counts, with small cells pooled."""

import numpy as np
from scipy.stats import chi2

FALSE_ALARM = 1e-2
"""Probability that any of a family of tests of correct samplers fails. Seeds are fixed, so that it fails always or never."""

SMALLEST_EXPECTED = 5.0


def assert_frequencies(observed: np.ndarray, expected: np.ndarray, *, tests: int = 1) -> None:
    """Assert that ``observed`` counts could have come from the density that ``expected`` counts were integrated from.

    ``tests``: how many such tests the family has, for Sidak's correction. Fails also on a negative density, on a mass other
    than one (up to 0.1 % of quadrature error), on any sample where the density is zero. Cells are pooled in order of their
    expected count until each pool expects SMALLEST_EXPECTED.
    """
    observed, expected = np.asarray(observed, np.float64).ravel(), np.asarray(expected, np.float64).ravel()
    assert (expected >= 0).all(), f"negative density: {expected.min():g}"
    mass = expected.sum() / observed.sum()
    assert abs(mass - 1) < 1e-3, f"the mass of the density is {mass:.5g}"
    stray = observed[expected == 0].sum()
    assert stray == 0, f"{stray:g} samples where the density is zero"
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
    limit = 1 - (1 - FALSE_ALARM) ** (1 / tests)
    assert probability > limit, (
        f"chi-square {statistic:.1f} on {len(counts) - 1} degrees of freedom, p = {probability:.2g} < {limit:.2g}"
    )
