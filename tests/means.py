"""Are two means the same? Welch's t-test of every component, Sidak-corrected, and of the sum of all components."""

import numpy as np
from scipy.stats import t as student

FALSE_ALARM = 1e-3
"""Probability that one call fails for equal means. Seeds are fixed, so that it fails always or never."""


def assert_same_mean(found: np.ndarray, expected: np.ndarray, *, resolution: float) -> None:
    """Assert that independent repeats ``found`` (R, ...) and ``expected`` (S, ...) have the same mean in every component.

    ``expected`` with S = 1 is taken as exact. The sum of all components, which sees a small bias that all of them share, is
    tested too. ``resolution``: standard error of the sum over the sum, which must be at most that, or nothing was tested.
    """
    found, expected = (np.asarray(a, np.float64).reshape(len(a), -1) for a in (found, expected))
    found, expected = (np.column_stack([a, a.sum(1)]) for a in (found, expected))
    error, freedom = _welch(found, expected)
    difference = found.mean(0) - expected.mean(0)
    seen = error[-1] / np.abs(expected.mean(0)[-1])
    assert seen <= resolution, f"the standard error is {seen:.2g} of the sum, expected at most {resolution:.2g}"
    still = error == 0  # no repeat differs from another: then there is nothing random, and both are rounded
    np.testing.assert_allclose(difference[still], 0, atol=1e-6 * np.abs(expected).max())
    score = np.abs(difference[~still] / error[~still])
    probability = 2 * student.sf(score, freedom[~still])
    limit = 1 - (1 - FALSE_ALARM) ** (1 / len(score))
    worst = int(probability.argmin())
    where = np.flatnonzero(~still)[worst]
    assert probability[worst] > limit, (
        f"component {where} of {len(error)} (the last is the sum): found {found.mean(0)[where]:.5g}, "
        f"expected {expected.mean(0)[where]:.5g}, |t| = {score[worst]:.1f}, p = {probability[worst]:.2g} < {limit:.2g}"
    )


def _welch(found: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard error of the difference of the means of each column, and its degrees of freedom (Welch, Satterthwaite)."""
    parts = [a.var(0, ddof=1) / len(a) if len(a) > 1 else np.zeros(a.shape[1]) for a in (found, expected)]
    below = sum(part**2 / max(len(a) - 1, 1) for part, a in zip(parts, (found, expected), strict=True))
    variance = parts[0] + parts[1]
    return np.sqrt(variance), np.divide(variance**2, below, out=np.ones_like(variance), where=below > 0)
