"""What a dense Gauss-Newton matrix says: how stiff, for which unknowns, under which parametrisation, and what is confused.

All functions take H (n, n), float64, symmetric, the mean over residuals of J^T J, and ``groups``: the indices (n_g,) of each
kind of parameter among the n. Eigenvalues are mean squared changes of the residual per unit of change of the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.linalg

Groups = Mapping[str, np.ndarray]

RANK = 1e-4
"""Directions that alone matter this much less than the most important one of their group are left out of comparisons
between groups: they change the images' root mean square a hundred times less."""


def condition(values: np.ndarray, share: float = 0.1) -> float:
    """Largest eigenvalue over the one that a ``share`` of all (n,) are smaller than.

    The very smallest is no measure: between a texel that hardly any pixel sees and one that none does there is no gap.
    """
    return float(values.max() / np.quantile(values, share))


def jacobi(matrix: np.ndarray) -> np.ndarray:
    """H with a diagonal of ones: what is left when every parameter has the rate that its own curvature calls for."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return matrix * scale * scale[:, None]


def shares(vectors: np.ndarray, groups: Groups) -> dict[str, float]:
    """Share of each group in the squared norm of unit vectors (n, k), averaged over them."""
    return {name: float((vectors[members] ** 2).sum(0).mean()) for name, members in groups.items()}


def kept_information(matrix: np.ndarray, groups: Groups) -> dict[str, float]:
    """Median over the parameters of a group of how much of their curvature is left when the other groups are unknown too.

    diag(S) / diag(H) with the Schur complement S = H_gg - H_go H_oo^-1 H_og: 1 where the others do not matter, 0 where they
    can stand in for the parameter.
    """
    kept = {}
    for name, own in groups.items():
        other = np.setdiff1d(np.arange(len(matrix)), own)
        across, rest = matrix[np.ix_(other, own)], matrix[np.ix_(other, other)]
        rest = rest + 1e-10 * np.diag(rest).max() * np.eye(len(other))  # texels that one pixel sees make it singular
        explained = (across * scipy.linalg.solve(rest, across, assume_a="pos")).sum(0)
        kept[name] = float(np.median(1 - explained / np.diag(matrix)[own]))
    return kept


def confusions(matrix: np.ndarray, groups: Groups) -> tuple[np.ndarray, np.ndarray]:
    """Combinations of the groups by how far they cancel in the images: values mu (m,), ascending, and directions (n, m).

    H u = mu D u, where D has the blocks of H on its diagonal. u^T D u is what the parts of u change when each acts alone, so mu
    is what is left of it when they act together: 1 for parts that do not interact, near 0 for those that images cannot tell
    apart, at most the number of groups. For two groups 1 - mu are the canonical correlations of their columns of J. Directions
    are scaled to u^T D u = 1; those of RANK are left out, so that nothing is called confused because it does not matter.
    """
    whitened = np.zeros((len(matrix), 0))  # parameters of no group stay as they are
    for own in groups.values():
        values, vectors = scipy.linalg.eigh(matrix[np.ix_(own, own)])
        used = values > RANK * values[-1]
        block = np.zeros((len(matrix), int(used.sum())))
        block[own] = vectors[:, used] / np.sqrt(values[used])
        whitened = np.concatenate([whitened, block], 1)
    mu, mixed = scipy.linalg.eigh(whitened.T @ matrix @ whitened)
    return mu, whitened @ mixed


def cancellation(matrix: np.ndarray, groups: Groups, direction: np.ndarray) -> float:
    """The quotient mu of :func:`confusions` for one direction (n,)."""
    alone = sum(direction[own] @ matrix[np.ix_(own, own)] @ direction[own] for own in groups.values())
    return float(direction @ matrix @ direction / alone)


def reparametrised(matrix: np.ndarray, own: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """H for new parameters z of one group, of which ``transform`` (n_g, m) times dz is the change of the old ones."""
    other = np.setdiff1d(np.arange(len(matrix)), own)
    across = matrix[np.ix_(other, own)] @ transform
    return np.block([[matrix[np.ix_(other, other)], across], [across.T, transform.T @ matrix[np.ix_(own, own)] @ transform]])


def light_transforms(radiance: np.ndarray, members: np.ndarray) -> dict[str, np.ndarray]:
    """How log radiance moves with other parameters of a light: name -> (n_l, m) for the ``members`` (n_l,) of a flat map.

    ``radiance`` (h, w, 3) > 0 is where the light stands, in units in which its mean is 1. "log": as it is; "linear": the radiance
    itself; "softplus": log(1 + exp(z)); "log + scale": a common factor a channel besides; "log pyramid": means of blocks of 2, 4,
    ... texels besides, down to the whole map.
    """
    height, width, channels = radiance.shape
    flat = radiance.reshape(-1)[members]
    index = np.arange(radiance.size).reshape(radiance.shape)
    levels, side = [], 2
    while side <= height:
        row, column = np.arange(height) // side, np.arange(width) // side
        levels.append(_indicator(((row[:, None] * width + column)[..., None] * channels + np.arange(channels)), members))
        side *= 2
    whole = _indicator(index % channels, members)
    identity = np.eye(len(members))
    return {
        "log": identity,
        "linear": np.diag(1 / flat),
        "softplus": np.diag(-np.expm1(-flat) / flat),
        "log + scale": np.concatenate([identity, whole], 1),
        "log pyramid": np.concatenate([identity, *levels, whole], 1),
    }


def _indicator(label: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Columns of ones, one for every label that occurs among the ``members`` of a flat map: (n_l, labels)."""
    _, place = np.unique(label.reshape(-1)[members], return_inverse=True)
    return np.eye(place.max() + 1)[place]
