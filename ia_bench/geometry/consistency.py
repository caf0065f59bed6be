"""Do masks and cameras agree with each other? Each view's outline against that of the hull of all views, and what mends it.

Where a mask is too large or a camera a little off, the outline of the object in that view lies beside that of the hull. To first
order, at a point of the outline with the outward normal n, the distance between both is

    r = g - n . J m

with g the pixels by which the mask is too large, m the camera's motion from where it should be (a rotation vector and a shift) and
J what that motion does to the image of the point of the hull that lies there. Seven unknowns a view are found by least squares,
with a penalty on each that holds what an outline cannot tell (of a round one, the roll of its camera) where it was; then the
hull is made again. It is the silhouettes' part of bundle adjustment, and asks for no texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation
from torch import Tensor

from ia_bench.common.progress import Begin, unseen
from ia_bench.geometry.grid import DistanceGrid
from ia_bench.geometry.hull import HALF, carving_mask, centre_of, grown_mask, outline_distance, slopes, visual_hull
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Camera, View

NEAR = 1.0  # pixels from the outline within which pixels are taken for points of it
CELLS = 64  # of the hull that outlines are compared with
SAMPLES = 96  # points along the ray of a pixel where its distance from the hull is looked for
PENALTIES = np.array([0.1] * 6 + [0.02])  # on the squares of motions and growth in pixels, against the mean square of distances
DOUBT = 1.0  # pixels; distances beyond count less: the weight of Cauchy's distribution
LEAST = 0.05  # pixels by which a mask has to be wrong before it is changed
STEP = 1e-3  # pixels by which a motion moves the image, when its effect is measured
USED = [0, 1, 2, 5]  # of the motions of pixel_motions: pan, tilt, roll, along the axis; shifts to the sides look like pan and tilt


def consistent(views: Sequence[View], rounds: int, tolerated: int, begin: Begin = unseen) -> tuple[View, ...]:
    """The views with cameras and masks that agree better with the hull of all of them, after so many rounds.

    A mask that was too large is made smaller, and one that was too small larger: what that adds is not ``valid``, since nobody
    knows what the photograph showed there. What all masks have in common cannot be told and stays. ``begin`` shows how far it is.
    """
    unknowns = np.zeros((len(views), 7))  # what was found so far, in pixels
    mended, task = tuple(views), begin("outlines", rounds)
    for _ in range(rounds):
        grid = visual_hull(mended, CELLS, tolerated)
        outlines = [outline(view, grid) for view in mended]
        common = np.median(np.concatenate([one.apart for one in outlines]))  # a hull that tolerates some views is larger
        unknowns += [_improvement(one, common, so_far) for one, so_far in zip(outlines, unknowns, strict=True)]
        told = [len(one.apart) > 0 for one in outlines]  # the others show no outline, and stay as they are
        unknowns[told, 5:] -= unknowns[told, 5:].mean(0)  # that all cameras come nearer, or all masks grow, is the size of the hull
        mended = tuple(_mended(*each) for each in zip(views, outlines, unknowns, strict=True))
        task.advance()
    return mended


@dataclass(frozen=True)
class Outline:
    """The outline of a view beside that of a shape: the distance ``apart`` (N,) in pixels of N points, and what explains it.

    ``system`` (N, 7): what a pixel of each unknown does to the distances: six motions of the camera in ``units``, and growth.
    """

    apart: np.ndarray
    system: np.ndarray
    units: np.ndarray


def outline(view: View, grid: DistanceGrid) -> Outline:
    """The outline of a view's mask beside that of the shape in ``grid``."""
    distance = outline_distance(carving_mask(view))
    seen = binary_erosion(view.known | (view.mask > 0), np.ones((5, 5)))  # the edges of what is seen, which cut, are no outlines
    rows, columns = np.nonzero((np.abs(distance) < NEAR) & seen)
    normal = slopes(distance)[::-1, rows, columns].T  # along columns, along rows
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    points, beyond = nearest_to_rays(view.camera, rows, columns, grid)
    far = float(np.linalg.norm(points.mean(0) - view.camera.position)) if len(points) else 1.0
    units = pixel_motions(view.camera, far, float((view.mask > HALF).sum()))
    effects = -(effects_of(view.camera, units, points) * normal).sum(-1)
    system = np.column_stack([*effects, np.ones(len(points))])
    return Outline(beyond - distance[rows, columns], system, units)


def _improvement(found: Outline, common: float, so_far: np.ndarray) -> np.ndarray:
    """What to add to the unknowns (7,): least squares, with a penalty on what they are then.

    It is reweighted a few times, so that single large distances decide little.
    """
    system, apart = found.system, found.apart - common
    penalty, change = len(apart) * np.diag(PENALTIES), np.zeros(7)
    for _ in range(5 if len(apart) else 0):
        weight = 1 / (1 + ((apart - system @ change) / DOUBT) ** 2)
        change = np.linalg.solve(system.T @ (weight[:, None] * system) + penalty, system.T @ (weight * apart) - penalty @ so_far)
    return change


def _mended(view: View, found: Outline, unknowns: np.ndarray) -> View:
    """The view with the camera moved back, and a mask that is smaller by as much as it was too large."""
    camera, growth = moved(view.camera, -found.units * unknowns[:6]), unknowns[6]
    if abs(growth) < LEAST:
        return replace(view, camera=camera)
    mask = grown_mask(view, -growth)
    added = (mask > 0) & (view.mask == 0)
    image = straight(view.image, view.mask) * mask[..., None]
    return replace(view, camera=camera, image=image, mask=mask, valid=view.known & ~added)


def nearest_to_rays(camera: Camera, rows: np.ndarray, columns: np.ndarray, grid: DistanceGrid) -> tuple[np.ndarray, np.ndarray]:
    """The point (N, 3) of each pixel's ray that is deepest in the shape, or nearest to it, and its distance in pixels (N,)."""
    along, origin = camera.rays(columns + 0.5, rows + 0.5), camera.position
    corners = np.stack(np.meshgrid(*zip(grid.low.tolist(), grid.high.tolist(), strict=True), indexing="ij"), -1).reshape(-1, 3)
    depths = (origin - corners) @ camera.to_world[:3, 2]
    depth = np.linspace(max(float(depths.min()), 1e-6 * float(depths.max())), float(depths.max()), SAMPLES)
    points = origin + depth[:, None, None] * along
    boxed = points.clip(grid.low.numpy(), grid.high.numpy())
    distance = grid.at(torch.from_numpy(boxed.reshape(-1, 3)).float()).numpy().reshape(points.shape[:2])
    distance += np.linalg.norm(points - boxed, axis=-1)
    pixels = distance * 0.5 * sum(camera.focal) / depth[:, None]
    place, every = pixels.argmin(0), np.arange(len(rows))
    return points[place, every], pixels[place, every]


def seen_at(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Columns and rows (N, 2) of points (N, 3)."""
    return np.stack(camera.project(points)[:2], -1)


def moved(camera: Camera, motion: np.ndarray) -> Camera:
    """The camera after a rotation vector and a shift (6,), both in its own frame."""
    to_world = np.array(camera.to_world, np.float64)
    to_world[:3, 3] += to_world[:3, :3] @ motion[3:]
    to_world[:3, :3] = to_world[:3, :3] @ Rotation.from_rotvec(motion[:3]).as_matrix()
    return replace(camera, to_world=to_world)


def effects_of(camera: Camera, units: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How each of six motions moves the images of points (N, 3), (6, N, 2) pixels for one of its ``units`` (6,)."""
    here = seen_at(camera, points)
    return np.stack([seen_at(moved(camera, STEP * units * one), points) - here for one in np.eye(6)]) / STEP


def pixel_motions(camera: Camera, distance: float, area: float) -> np.ndarray:
    """Six motions (6,), radians and scene units, each of which moves the image of a ball at ``distance`` by about a pixel.

    Pan and tilt, roll; shifts to the sides and along the axis. The ball covers ``area`` pixels.
    """
    focal, radius = 0.5 * sum(camera.focal), max(float(np.sqrt(area / np.pi)), 1.0)
    return np.array([1 / focal, 1 / focal, 1 / radius, distance / focal, distance / focal, distance / radius])


# ---------------------------------------------------------------- photographs that move while a surface is fitted
class MovingPhotographs:
    """The pictures of all views, H x W each, looked up where their pixels belong, which is found together with a surface.

    To first order, a camera that is a little off shows a far object shifted, turned or scaled: four unknowns of a view, in pixels,
    take the place of its pose while a surface is fitted (:mod:`~ia_bench.geometry.refinement`), and are then made a motion of it.

    ``offsets`` (V, 4) in pixels, what is fitted: to the right, down, turned and scaled about the middle of the mask, the last two
    measured at the radius of a disk as large as it.
    """

    def __init__(self, views: Sequence[View]) -> None:
        channels = []
        for view in views:
            known = view.known
            parts = view.image, view.mask[..., None], known[..., None], (known | (view.mask > 0))[..., None]
            channels.append(np.concatenate(parts, -1, dtype=np.float32))
        self._pictures = torch.from_numpy(np.stack(channels))  # (V, H, W, 6)
        covered = [np.nonzero(_shown(view.mask)) for view in views]
        self._middle = torch.tensor([[columns.mean() + 0.5, rows.mean() + 0.5] for rows, columns in covered]).float()
        self._radius = torch.tensor([max(float(np.sqrt(len(rows) / np.pi)), 1.0) for rows, _ in covered])
        self.offsets = torch.zeros(len(views), 4, requires_grad=True)

    def at(self, view: Tensor, place: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Colour (N, 3), coverage (N,) and whether each is known (N,), of what belongs to column and row ``place`` (N, 2)."""
        apart = (place - self._middle[view]) / self._radius[view, None]
        right, down, turned, scaled = self.offsets[view].unbind(-1)
        x, y = apart.unbind(-1)
        column = place[:, 0] + right - turned * y + scaled * x - 0.5
        row = place[:, 1] + down + turned * x + scaled * y - 0.5
        height, width = self._pictures.shape[1:3]
        left, top = column.detach().floor().clamp(0, width - 2).long(), row.detach().floor().clamp(0, height - 2).long()
        u, v = (column - left).clamp(0, 1)[:, None], (row - top).clamp(0, 1)[:, None]
        corners = [self._pictures[view, top + below, left + beside] for below in (0, 1) for beside in (0, 1)]
        found = (1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[2] + u * corners[3])
        known = (found.detach()[:, 4:] > 0.999).float()
        return found[:, :3], found[:, 3], known[:, 0], known[:, 1]

    def cameras(self, views: Sequence[View]) -> list[Camera]:
        """The cameras of the views after the motions that offset their pictures as they are offset."""
        centre = centre_of(views)
        with torch.no_grad():
            return [self._camera(number, view.camera, centre) for number, view in enumerate(views)]

    def _camera(self, number: int, camera: Camera, centre: np.ndarray) -> Camera:
        radius, middle = float(self._radius[number]), self._middle[number].numpy().astype(np.float64)
        around = radius * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 16, endpoint=False)])
        right, down, turned, scaled = self.offsets[number].double().tolist()
        x, y = around.T / radius
        wanted = np.stack([right - turned * y + scaled * x, down + turned * x + scaled * y], -1)
        far = float(np.linalg.norm(centre - camera.position))
        points = camera.position + far * camera.rays(*(middle + around).T)
        units = pixel_motions(camera, far, float(np.pi * radius**2))
        effects = effects_of(camera, units, points)[USED].reshape(len(USED), -1)
        motion = np.zeros(6)
        motion[USED] = np.linalg.lstsq(effects.T, wanted.ravel(), rcond=None)[0]
        return moved(camera, units * motion)


def _shown(mask: np.ndarray) -> np.ndarray:
    """Which pixels (H, W) of a ``mask`` show the object: those above a half, else above 0, else all, so that they have a middle."""
    return next(part for part in (mask > HALF, mask > 0, np.ones(mask.shape, bool)) if part.any())
