"""How much of a texture belongs to several places of a mesh at once: mirrored or stacked texture coordinates."""

from __future__ import annotations

import numpy as np

SIDE = 512  # points along a side of the texture that are looked at
AT_ONCE = 2**16  # triangles


def shared_texture(uv: np.ndarray, faces: np.ndarray) -> float:
    """The share of the texture covered by triangles that more than one of them covers, between 0 and 1; 0 if none covers any.

    ``uv`` (V, 2) in [0, 1], ``faces`` (F, 3). Counted at SIDE x SIDE points, so edges that triangles share do not count.
    """
    change = np.zeros(SIDE * (SIDE + 1), np.int64)  # of the number of triangles, along each row of points
    points = uv.astype(np.float64) * SIDE - 0.5  # the first point lies half a step from the border
    for part in np.split(faces, range(AT_ONCE, len(faces), AT_ONCE)):
        row, first, end = _spans(points[part])
        np.add.at(change, row * (SIDE + 1) + first, 1)
        np.add.at(change, row * (SIDE + 1) + end, -1)
    layers = change.reshape(SIDE, SIDE + 1).cumsum(1)
    return float((layers > 1).sum() / max((layers > 0).sum(), 1))


def _spans(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points inside of triangles with these corners (F, 3, 2): for each row of each its number, first column and end.

    Ranges are half open, so a point on an edge that two triangles share is inside of one of them alone.
    """
    low, high = (np.ceil(edge).astype(np.int64).clip(0, SIDE) for edge in (corners[..., 1].min(1), corners[..., 1].max(1)))
    rows = high - low
    triangle = np.repeat(np.arange(len(corners)), rows)
    row = np.arange(len(triangle)) - np.repeat(rows.cumsum() - rows, rows) + low[triangle]
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for one, two in ((0, 1), (1, 2), (2, 0)):
        (x, y), (to_x, to_y) = corners[triangle, one].T, corners[triangle, two].T
        crosses = (np.minimum(y, to_y) <= row) & (row < np.maximum(y, to_y))
        column = x + (row - y) / np.where(crosses, to_y - y, 1) * (to_x - x)
        left, right = np.where(crosses, np.minimum(left, column), left), np.where(crosses, np.maximum(right, column), right)
    first, end = (np.ceil(column).clip(0, SIDE).astype(np.int64) for column in (left, right))
    some = end > first
    return row[some], first[some], end[some]
