"""Where photographs belong, found together with the surface: each is moved on its picture plane until it shows what others show.

To first order, a camera that is a little off shows a far object shifted, turned or scaled: four unknowns of a view, in pixels,
take the place of its pose while a surface is fitted (:mod:`~ia_bench.geometry.refinement`), and are then made a motion of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.geometry.consistency import moved, pixel_motions, seen_at
from ia_bench.geometry.silhouettes import HALF, centre_of
from ia_bench.scenes.scene import Camera, View

STEP = 1e-3  # pixels by which a motion moves the image, when its effect is measured
USED = [0, 1, 2, 5]  # of the motions of pixel_motions: pan, tilt, roll, along the axis; shifts to the sides look like pan and tilt


class MovingPhotographs:
    """The pictures of all views, H x W each, looked up where their pixels belong.

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
        covered = [np.nonzero(view.mask > HALF) for view in views]
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
        return [self._camera(number, view.camera, centre) for number, view in enumerate(views)]

    @torch.no_grad()
    def _camera(self, number: int, camera: Camera, centre: np.ndarray) -> Camera:
        radius, middle = float(self._radius[number]), self._middle[number].numpy().astype(np.float64)
        around = radius * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 16, endpoint=False)])
        right, down, turned, scaled = self.offsets[number].double().tolist()
        x, y = around.T / radius
        wanted = np.stack([right - turned * y + scaled * x, down + turned * x + scaled * y], -1)
        far = float(np.linalg.norm(centre - camera.position))
        points = camera.position + far * camera.rays(*(middle + around).T)
        units = pixel_motions(camera, far, float(np.pi * radius**2))
        here = seen_at(camera, points)
        effects = [(seen_at(moved(camera, STEP * units * one), points) - here).ravel() / STEP for one in np.eye(6)[USED]]
        motion = np.zeros(6)
        motion[USED] = np.linalg.lstsq(np.stack(effects, -1), wanted.ravel(), rcond=None)[0]
        return moved(camera, units * motion)
