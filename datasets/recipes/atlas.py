"""One UV atlas for the whole object (xatlas), and the filling of the texels between its charts."""

import numpy as np
import xatlas
from mesh import face_normals
from numpy.typing import NDArray

PADDING = 2
"""Texels between charts at the resolution that the atlas is packed for, twice the texture's; xatlas adds one for filtering.

Three of those are one and a half of the texture's own: bilinear filtering in one chart reads no texel of another.
"""

EXHAUSTIVE = 2048
"""Largest atlas, texels a side, whose charts are placed by looking at every place.

The time for it grows fivefold when the side doubles (`hat`: 8 s, 39 s, more than 8 minutes at 4096); places drawn by chance
take 7 s at any size and use about as much of it (`hat`: .71 for .73 at 1024, .65 for .64 at 2048).
"""

MAX_OVERLAP = 2e-4
"""Share of the used texels that may belong to two places (slivers that fold over inside a chart)."""


def unwrap(positions: NDArray[np.float32], faces: NDArray[np.int32], size: int) -> tuple[NDArray[np.float32], str]:
    """UV (F, 3, 2) of one atlas with the same texel density everywhere; a line of statistics.

    xatlas packs into a rectangle; it is stretched to the square, so that no space is lost. Texels are then not quite
    square on the surface.

    Args:
        positions: (P, 3), welded, so that charts may cross edges.
        faces: (F, 3).
        size: side of the texture that the atlas is packed for, texels.

    Raises:
        RuntimeError: if more than MAX_OVERLAP of the used texels are covered twice.
    """
    charts, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    # Fewer seams than with xatlas' own 2 and 4. Less weight on the deviation of normals than its own 2 would flatten whole
    # crowns and heads into one chart, with texels three times as long as the median.
    charts.max_cost, charts.normal_seam_weight, charts.normal_deviation_weight = 4.0, 1.0, 2.0
    pack.resolution, pack.padding, pack.bilinear, pack.bruteForce = size, PADDING, True, size <= EXHAUSTIVE
    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces)
    atlas.generate(charts, pack)
    _, corner, vertex_uv = atlas[0]
    uv = vertex_uv[corner].astype(np.float32)
    covered = coverage_count(uv, size)
    used, twice = int((covered > 0).sum()), int((covered > 1).sum())
    if twice > MAX_OVERLAP * used:
        raise RuntimeError(f"the atlas overlaps itself in {twice} of {used} texels")
    edges = uv[:, 1:] - uv[:, :1]
    uv_area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    density = np.sqrt(uv_area / np.linalg.norm(face_normals(positions, faces), axis=1)) * size
    low, middle, high = np.percentile(density, (5, 50, 95))
    return uv, (
        f"{atlas.chart_count} charts on {atlas.width} x {atlas.height}, {used / size**2:.1%} used, "
        f"{twice} texels used twice, texels per unit at {size}: {middle:.0f} (5 % to 95 %: {low:.0f} to {high:.0f})"
    )


def coverage_count(uv: NDArray[np.float32], size: int) -> NDArray[np.int32]:
    """How many triangles of uv (F, 3, 2) cover the centre of each texel, (size, size), row 0 at v = 1."""
    count = np.zeros((size, size), dtype=np.int32)
    points = np.stack([uv[..., 0] * size, (1 - uv[..., 1]) * size], axis=-1).astype(np.float64)
    for triangle in points:
        low = np.maximum(np.floor(triangle.min(axis=0) - 0.5).astype(int), 0)
        high = np.ceil(triangle.max(axis=0) + 0.5).astype(int)
        x, y = np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1])[:, None] + 0.5
        inside = np.ones((y.size, x.size), dtype=bool)
        (ax, ay), (bx, by), (cx, cy) = triangle
        turn = np.sign((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
        for (px, py), (qx, qy) in ((triangle[i], triangle[(i + 1) % 3]) for i in range(3)):
            # Open triangles: a shared edge belongs to neither.
            inside &= turn * ((qx - px) * (y - py) - (qy - py) * (x - px)) > 1e-9
        window = count[low[1] : high[1], low[0] : high[0]]
        window += inside[: window.shape[0], : window.shape[1]]
    return count


def dilate(image: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill the unknown texels of an image (H, W, C) ring by ring with the mean of their known neighbours.

    The first ring is what bilinear filtering at the rim of a chart reads; the rest serves coarser readers.
    """
    filled, known = np.where(known[..., None], image, 0).astype(np.float32), known.copy()
    if not known.any():
        raise ValueError("expected a texture with some baked texels, found none")
    while not known.all():
        total, weight = np.zeros_like(filled), np.zeros(known.shape, dtype=np.float32)
        for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            total += np.roll(filled, (dy, dx), axis=(0, 1))
            weight += np.roll(known, (dy, dx), axis=(0, 1))
        ring = ~known & (weight > 0)
        filled[ring] = total[ring] / weight[ring][:, None]
        known |= ring
    return filled
