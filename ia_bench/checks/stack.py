"""Small posed images of one object with the truth behind them, for checking priors: from a scene, or computed here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.paths import scenes_folder
from ia_bench.priors.contract import COMPONENTS, Observations
from ia_bench.scenes.scene import Camera, View

FIELD_OF_VIEW = 0.6  # radians, across the narrower side
VIEWS = 3  # that a prior is asked about
DISTANCE = 4.2  # of the cameras from the centre of the unit ball


@dataclass(frozen=True)
class Stack:
    """Views of one size, with ground-truth albedo and specular shading, and the tensors that a prior is given."""

    views: tuple[View, ...]

    @property
    def images(self) -> Tensor:
        """(V, H, W, 3) linear radiance, premultiplied; new memory at every call."""
        return torch.from_numpy(np.stack([view.image for view in self.views]))

    @property
    def masks(self) -> Tensor:
        """(V, H, W) coverage; new memory at every call."""
        return torch.from_numpy(np.stack([view.mask for view in self.views]))

    def truth(self, component: str) -> Tensor:
        """(V, H, W, 3) ground truth of "albedo" or "specular"; new memory at every call."""
        return torch.from_numpy(np.stack([getattr(view, component) for view in self.views]))

    def shown(self, wants: frozenset[str] = frozenset()) -> Observations:
        """What a prior that ``wants`` these is shown: geometry is that of a surface that faces the camera and is half open.

        Every view is the only one that shows its surface.
        """
        masks = self.masks[..., None]
        normals = masks * torch.tensor([0.0, 0.0, 1.0]) if "normals" in wants else None
        visibility = 0.5 * masks if "visibility" in wants else None
        truth = {name: self.truth(name) for name in COMPONENTS} if "truth" in wants else None
        view_count = torch.ones_like(masks) * (masks > 0) if "view_count" in wants else None
        return Observations(self.images, self.masks, None, normals, visibility, view_count, truth)

    def one(self, view: int) -> Stack:
        """The stack of that view alone."""
        return Stack(self.views[view : view + 1])

    def black(self) -> Stack:
        """The same object in the dark: masks and albedo stay, everything radiant is zero."""
        nothing = np.zeros_like(self.views[0].image)
        return Stack(tuple(replace(view, image=nothing, specular=nothing) for view in self.views))

    def with_empty_view(self) -> Stack:
        """The first view sees nothing: its mask and all its pictures are zero."""
        nothing = np.zeros_like(self.views[0].image)
        empty = replace(self.views[0], image=nothing, mask=nothing[..., 0], albedo=nothing, specular=nothing)
        return Stack((empty, *self.views[1:]))


def example_stack() -> tuple[Stack, str]:
    """The first training views of the shipped scene ``tiny``, or a painted ball where it is absent; and which it is."""
    try:
        folder = scenes_folder() / "tiny"
    except InputError:
        folder = None
    if folder is None or not folder.is_dir():
        return painted_ball(32, 32, VIEWS), f"{VIEWS} computed views of a painted ball, 32 x 32"
    from ia_bench.readers.native import NativeReader

    chosen = NativeReader(folder).read(truth=True).train[:VIEWS]
    height, width = chosen[0].mask.shape
    return Stack(chosen), f"{VIEWS} views of scene tiny, {height} x {width}"


def painted_ball(height: int, width: int, views: int) -> Stack:
    """A unit ball with coloured bands under one directional light: Lambert's and Blinn's terms in closed form."""
    return Stack(tuple(_ball_view(height, width, 2 * math.pi * view / views + 0.3, view) for view in range(views)))


def _ball_view(height: int, width: int, angle: float, number: int) -> View:
    outward = np.array([math.cos(angle), math.sin(angle), 0.4])
    outward /= np.linalg.norm(outward)
    right = np.cross([0.0, 0.0, 1.0], outward)
    right /= np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3, :3] = np.stack([right, np.cross(outward, right), outward], 1)
    to_world[:3, 3] = DISTANCE * outward
    focal = 0.5 * min(height, width) / math.tan(0.5 * FIELD_OF_VIEW)
    camera = Camera(to_world, (focal, focal), (0.5 * width, 0.5 * height), width, height)

    rows, columns = np.meshgrid((np.arange(2 * height) + 0.5) / 2, (np.arange(2 * width) + 0.5) / 2, indexing="ij")
    local = np.stack([(columns - 0.5 * width) / focal, -(rows - 0.5 * height) / focal, -np.ones_like(rows)], -1)
    ray = local @ to_world[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    middle = -(ray @ to_world[:3, 3])
    discriminant = middle**2 - DISTANCE**2 + 1
    hit = (discriminant > 0)[..., None]
    normal = to_world[:3, 3] + (middle - np.sqrt(discriminant.clip(0)))[..., None] * ray
    light = np.array([0.5, 0.3, 0.8]) / np.linalg.norm([0.5, 0.3, 0.8])
    half = light - ray
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    albedo = 0.45 + 0.3 * np.sin(normal @ np.array([[5.0, 1.0, 2.0], [0.0, 4.0, 3.0], [3.0, 2.0, 6.0]]))
    specular = 0.6 * (normal * half).sum(-1, keepdims=True).clip(0) ** 60 * np.ones(3)
    image = albedo * ((normal @ light).clip(0)[..., None] + 0.15) + specular

    def pooled(values: np.ndarray) -> np.ndarray:
        """Box filter of the 2 x 2 points of a pixel; what misses the ball counts as zero."""
        points = (hit * values).reshape(height, 2, width, 2, -1)
        return points.mean((1, 3)).astype(np.float32)

    mask = pooled(np.ones_like(hit, np.float64))[..., 0]
    return View(f"{number:04d}", camera, pooled(image), mask, albedo=pooled(albedo), specular=pooled(specular))
