"""Where the error of the albedo sits: the squared error of encoded albedo, before any alignment, as a sum of four parts.

With e the error of a scored pixel, a what is left of it after one factor per channel, and b the smoothed a,

    unseen:  e^2 where no photograph shows the pixel's surface, and elsewhere, where photographs do,
    level:   e^2 - a^2, what a factor per channel takes away that makes the means over all views equal: brightness and cast;
    low:     a b, what of the rest is the same all around on the surface: shading in the paint, patches;
    high:    a (a - b), what is different from place to place: texture, noise, shadow edges.

Low and high share their mixed term evenly, since a^2 = b^2 + (a - b)^2 + 2 b (a - b). Sums over pixels are what they say: a
single pixel's ``low`` or ``level`` may be negative.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ia_bench.render.gbuffer import sees, trace_gbuffer
from ia_bench.render.stage import Stage
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Camera, Mesh, View, farthest_first
from ia_bench.scores.comparison import Pair
from ia_bench.scores.metrics import ERROR_PARTS, NoScoredPixel, Undefined
from ia_bench.scores.protocol import Protocol

WIDTH = 0.05  # of the Gaussian that smooths, over the diagonal of the box of all places that are smoothed
CELLS = 2  # along that width; errors are smoothed on a grid
STEPS = 6  # toward the factor, each of which leaves a small part of the error of the one before
GAMMA = 2.2  # the power by which encoded values become linear, about
DARK = 0.1  # of sRGB means: below, that is no power any more, but nearly linear
DARKEST = 1e-6  # a mean below it is not told from black


class VisibleSurface(NamedTuple):
    """The N pixels of some views whose middle shows a surface.

    Attributes:
        position: (N, 3) in scene units.
        normal: (N, 3), unit.
        seen: (N,) bool, whether any photograph shows the place, as :func:`~ia_bench.render.gbuffer.sees` says.
        entry: A map (H, W) int of each view: which of the N a pixel is, -1 for none.
    """

    position: np.ndarray
    normal: np.ndarray
    seen: np.ndarray
    entry: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, mesh: Mesh, cameras: Sequence[Camera], photographs: Sequence[View], device: torch.device) -> VisibleSurface:
        """What ``cameras`` see of a mesh, of which there are ``photographs`` of others."""
        stage, entries, count = Stage(mesh, device), [], 0
        parts = []
        for camera in cameras:
            gbuffer = trace_gbuffer([camera], stage.rays, 1, device)
            parts.append(stage.surface(gbuffer.face[:, 0], gbuffer.barycentric[:, 0], gbuffer.seen_from()))
            entry = gbuffer.entry_of_pixel().cpu().numpy().reshape(camera.height, camera.width)
            entries.append(np.where(entry >= 0, entry + count, -1))
            count += len(gbuffer.pixel)
        position, normal, geometric = (torch.cat([getattr(p, n) for p in parts]) for n in ("position", "normal", "geometric"))
        seen = torch.zeros(count, dtype=torch.bool, device=device)
        middle = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
        for view in farthest_first(photographs, middle) if photographs else ():  # most places are found by the first few
            left = torch.nonzero(~seen)[:, 0]
            seen[left] = _shown(photographs[view], position[left], geometric[left], stage)
        return cls(position.cpu().numpy(), normal.cpu().numpy(), seen.cpu().numpy(), tuple(entries))


def _shown(photograph: View, position: Tensor, normal: Tensor, stage: Stage) -> Tensor:
    """Whether a photograph shows places (N, 3) well: (N,) bool, False for those that it would show beyond its own pixels."""
    seen = sees([photograph.camera], position, normal, stage.rays, stage.surface.offset)[:, 0]
    if photograph.valid is not None:
        column, row, _ = photograph.camera.project(position[seen])
        beyond = torch.from_numpy(photograph.beyond).to(seen.device)
        height, width = beyond.shape  # of some points alone the projection may round to the border
        seen[seen.clone()] = ~beyond[row.long().clamp(0, height - 1), column.long().clamp(0, width - 1)]
    return seen


def split(views: Sequence[Pair], shown: VisibleSurface, protocol: Protocol) -> tuple[dict[str, float], ...]:
    """The parts of the error in views of albedo, means over the scored pixels and channels of each.

    Raises Undefined where no view has a scored pixel or the prediction is not finite in one.
    """
    places = [entry[view.mask] for view, entry in zip(views, shown.entry, strict=True)]
    at = np.concatenate(places)
    predicted = np.concatenate([view.predicted[view.mask].astype(np.float32) for view in views])
    encoded = np.concatenate([_encoded(view.true[view.mask], protocol).astype(np.float32) for view in views])
    if not len(at):
        raise NoScoredPixel
    if not np.isfinite(predicted).all():
        raise Undefined("the prediction is not finite")
    seen = np.append(shown.seen, True)[at]  # -1, of an edge's pixel whose middle misses the mesh, reads the last: it counts as seen
    factor = _factor(predicted[seen], encoded[seen], protocol)
    inside = seen & (at >= 0)
    after = _encoded(predicted[inside] * factor.astype(np.float32), protocol) - encoded[inside]
    smooth = np.zeros_like(predicted)
    smooth[inside] = _smoothed(after, shown.position[at[inside]], shown.normal[at[inside]])
    ends = np.cumsum([len(one) for one in places])[:-1]
    of_view = zip(views, *(np.split(values, ends) for values in (seen, smooth)), strict=True)
    return tuple(_parts(view, factor, seen, smooth, protocol) for view, seen, smooth in of_view)


def _parts(view: Pair, factor: np.ndarray, seen: np.ndarray, smooth: np.ndarray, protocol: Protocol) -> dict[str, float]:
    """The parts of a view's error, of whose N scored pixels ``seen`` (N,) are shown; ``smooth`` (N, 3) is their smoothed error."""
    predicted, encoded = view.predicted[view.mask], _encoded(view.true[view.mask], protocol)
    before = _encoded(predicted, protocol) - encoded
    after = _encoded(predicted * factor, protocol) - encoded
    squares = {
        "unseen": before**2 * ~seen[:, None],
        "level": (before**2 - after**2) * seen[:, None],
        "low": after * smooth,
        "high": after * (after - smooth) * seen[:, None],
    }
    return {name: float(squares[name].mean()) if len(seen) else 0.0 for name in ERROR_PARTS}


def _encoded(linear: np.ndarray, protocol: Protocol) -> np.ndarray:
    return np.clip(linear_to_srgb(linear) if protocol.albedo_encoding == "srgb" else linear, 0.0, 1.0)


def _factor(predicted: np.ndarray, encoded: np.ndarray, protocol: Protocol) -> np.ndarray:
    """The factor (3,) of (N, 3) linear values that brings their encoded means to those of ``encoded``; 1 where there is none.

    Means, for the factor of least squares would be too small beside noise, and so take away some of that. There is none for a
    black channel, and where so many values are black that all others at white were still too dark.
    """
    factor = np.ones(3)
    if len(predicted):
        wanted = encoded.mean(0, dtype=np.float64)
        possible = (wanted > DARKEST) & (wanted <= (predicted > 0).mean(0))
        for _ in range(STEPS):
            mean = _encoded(predicted * factor.astype(np.float32), protocol).mean(0, dtype=np.float64)
            curved = (protocol.albedo_encoding == "srgb") & (np.maximum(mean, wanted) > DARK)
            step = (wanted / np.maximum(mean, DARKEST)) ** np.where(curved, GAMMA, 1.0)  # too large a power would never arrive
            factor = np.where((mean > DARKEST) & possible, factor * step, 1.0)
    return factor


def _smoothed(values: np.ndarray, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Weighted means (N, 3) of ``values`` around places (N, 3), by a Gaussian of WIDTH.

    Each place counts to six sheets, by how much its normal (N, 3) looks along +-x, +-y, +-z, so that both sides of something thin
    stay apart (the squared cosines sum to one). A sheet is a grid of cells, which is smoothed with the count of places in it.
    """
    from scipy.ndimage import gaussian_filter  # only the scores of a whole run need it

    if not len(values):
        return values
    low = position.min(0)
    size = max(WIDTH / CELLS * float(np.linalg.norm(position.max(0) - low)), 1e-12)
    cell = ((position - low) / size).astype(np.int32)
    shape = cell.max(0) + 1
    flat = np.ravel_multi_index(tuple(cell.T), shape)
    del cell
    columns, power = [np.zeros(len(values)) for _ in values.T], np.zeros(len(values))
    for part, axis in itertools.product((np.maximum, np.minimum), normal.T):
        weight = part(axis, 0) ** 2
        for total, values_of in ((power, 1.0), *zip(columns, values.T, strict=True)):
            grid = np.bincount(flat, weight * values_of, shape.prod()).reshape(shape)
            total += weight * gaussian_filter(grid, CELLS, mode="constant").reshape(-1)[flat]
    return np.stack([column / np.maximum(power, 1e-12) for column in columns], 1)
