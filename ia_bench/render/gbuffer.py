"""What every pixel sees: triangle and barycentrics of a few points per pixel, found once, interpolated on use.

Sizes: P pixels that see the mesh, S points in each of them, V views of H x W pixels; N = P S points when they lie flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.warp_launch import launch
from ia_bench.material.brdf import normalize
from ia_bench.render.kernels import average, interpolate, land
from ia_bench.render.rays import RayCaster
from ia_bench.scenes.scene import Camera, Mesh

RAYS_AT_ONCE = 2**18  # primary rays traced together: about 50 MB while they are made
PIXELS_AT_ONCE = 2**18  # whose points are looked up together: of all of 100 large views they would take gigabytes
MARGIN = 0.5  # pixels around the image of a triangle, for the rounding of rays
GRAZING = 0.2  # cosine below which a pixel shows a surface too obliquely to say much about it


@dataclass(frozen=True)
class SurfacePoints:
    """Points on the surface as seen by a camera.

    Attributes:
        position: (N, 3) in scene units.
        normal: (N, 3), unit: the shading normal, on the viewer's side.
        view: (N, 3), unit: toward the camera.
        uv: (N, 2) in [0, 1], (0, 0) at the texture's lower left corner.
        geometric: (N, 3), unit: the triangle's own normal, on the viewer's side.
        front: (N, 1) bool, whether the viewer is on the side from which the triangle is wound counter-clockwise.
    """

    position: Tensor
    normal: Tensor
    view: Tensor
    uv: Tensor
    geometric: Tensor
    front: Tensor


@dataclass(frozen=True)
class GBuffer:
    """Hits of ``subsamples`` stratified points in every pixel that sees the mesh at all: P entries, one a pixel.

    Where a method takes ``entries``, they are any index into the P, and None stands for all of them.

    Attributes:
        face: (P, S) int32, the triangle that each point of the pixel hits, -1 for a miss.
        barycentric: (P, S, 2) in [0, 1], the weights of the triangle's corners 1 and 2.
        pixel: (P,) int64, flat index into the stacked views (view, row, column), ascending as it is traced.
        to_world: (V, 4, 4), the cameras' matrices.
        shape: (V, H, W), the number of views and their size in pixels.
    """

    face: Tensor
    barycentric: Tensor
    pixel: Tensor
    to_world: Tensor
    shape: tuple[int, int, int]

    @property
    def subsamples(self) -> int:
        """The number of points in a pixel, S."""
        return self.face.shape[1]

    @property
    def origin(self) -> Tensor:
        """The camera centres, (V, 3) in scene units."""
        return self.to_world[:, :3, 3]

    @property
    def size_bytes(self) -> int:
        """Memory that it takes, about."""
        return self.face.nbytes + self.barycentric.nbytes + self.pixel.nbytes

    def view(self, entries: Tensor | None = None) -> Tensor:
        """Which of the V views the pixels of N entries belong to, (N,) int64."""
        pixel = self.pixel if entries is None else self.pixel[entries]
        return pixel // (self.shape[1] * self.shape[2])

    def seen_from(self, entries: Tensor | None = None) -> Tensor:
        """The camera centres from which the pixels of N entries are seen, (N, 3) in scene units."""
        return self.origin[self.view(entries)]

    def entries_by_view(self) -> tuple[Tensor, ...]:
        """The entries (N,) of each of the V views."""
        ends = torch.searchsorted(self.pixel, math.prod(self.shape[1:]) * torch.arange(1, self.shape[0], device=self.pixel.device))
        return torch.arange(len(self.pixel), device=self.pixel.device).tensor_split(ends.tolist())

    def entry_of_pixel(self) -> Tensor:
        """The entry of every pixel of the stacked views, (V H W,) int32, -1 where it misses the mesh: ``pixel`` inverted."""
        entry = torch.full((math.prod(self.shape),), -1, dtype=torch.int32, device=self.pixel.device)
        entry[self.pixel] = torch.arange(len(self.pixel), dtype=torch.int32, device=self.pixel.device)
        return entry

    @property
    def filled(self) -> Tensor:
        """(P,) bool, whether all points of the pixel hit: one on an edge mixes in a background."""
        return (self.face >= 0).all(1)

    def at(self, entries: Tensor) -> GBuffer:
        """The G-buffer of these (Q,) entries alone."""
        return replace(self, face=self.face[entries], barycentric=self.barycentric[entries], pixel=self.pixel[entries])

    def images(self, values: Tensor) -> Tensor:
        """Values of all entries, (P, ...), as images (V, H, W, ...); pixels that miss the mesh are zero."""
        flat = values.new_zeros(math.prod(self.shape), *values.shape[1:])
        flat[self.pixel] = values
        return flat.reshape(*self.shape, *values.shape[1:])

    def coverage(self) -> Tensor:
        """Fraction of each pixel's points that hit, as images (V, H, W)."""
        return self.images((self.face >= 0).float().mean(1))


def primary_rays(camera: Camera, side: int, pixels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Rays through the centres of a ``side`` x ``side`` grid in each pixel: origins and unit directions, (H, W, S, 3).

    ``pixels`` (P,): only of these, by their flat indices, (P, S, 3).
    """
    chosen = np.arange(camera.height * camera.width).reshape(camera.height, -1) if pixels is None else pixels
    row, column = np.divmod(chosen[..., None], camera.width)
    down, across = np.divmod(np.arange(side * side), side)
    directions = camera.rays(column + (across + 0.5) / side, row + (down + 0.5) / side)
    directions = (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).astype(np.float32)
    return np.broadcast_to(camera.position.astype(np.float32), directions.shape).copy(), directions


def pixels_in_reach(camera: Camera, mesh: Mesh) -> np.ndarray:
    """Flat indices (P,) of the pixels inside the bounding box of any triangle's image: no other pixel can see the mesh."""
    size = camera.width, camera.height
    *places, depth = camera.project(mesh.vertices)
    if (depth <= 0).any():  # a triangle that reaches behind the camera may be anywhere
        return np.arange(size[0] * size[1])
    image = np.stack(places, -1)
    corners = [image[corner] for corner in mesh.faces.T]
    first = np.floor(np.minimum.reduce(corners) - MARGIN).clip(0, size).astype(int)
    last = np.ceil(np.maximum.reduce(corners) + MARGIN).clip(0, size).astype(int)
    height, width = size[1] + 1, size[0] + 1
    boxes = np.zeros(height * width, int)  # summed over rows and columns: how many boxes a pixel lies in
    for columns, rows, sign in ((first, first, 1), (last, first, -1), (first, last, -1), (last, last, 1)):
        boxes += sign * np.bincount(rows[:, 1] * width + columns[:, 0], minlength=height * width)
    return np.flatnonzero(boxes.reshape(height, width).cumsum(0).cumsum(1)[:-1, :-1])


def trace_gbuffer(cameras: list[Camera], rays: RayCaster, side: int, device: torch.device) -> GBuffer:
    """Trace ``side`` x ``side`` points in every pixel of every camera (all of one size)."""
    faces, barycentrics, pixels, (height, width) = [], [], [], (cameras[0].height, cameras[0].width)
    poses = torch.from_numpy(np.stack([camera.to_world for camera in cameras]).astype(np.float32)).to(device)
    for view, camera in enumerate(cameras):
        if (camera.height, camera.width) != (height, width):
            raise ValueError(f"view {view} is {camera.height} x {camera.width}, the first is {height} x {width}")
        reached = pixels_in_reach(camera, rays.mesh)
        centre = poses[view, None, :3, 3].contiguous()
        for chosen in np.array_split(reached, max(1, -(-len(reached) * side**2 // RAYS_AT_ONCE))):
            directions = torch.from_numpy(primary_rays(camera, side, chosen)[1]).to(device)
            face, barycentric, _ = rays.intersect(centre, directions.reshape(1, -1, 3), coherent=True)
            face = face.reshape(-1, side * side)
            seen = (face >= 0).any(1)
            faces.append(face[seen].int())
            barycentrics.append(barycentric.reshape(-1, side * side, 2)[seen])
            pixels.append(torch.from_numpy(chosen).to(device)[seen] + view * height * width)
    return GBuffer(_joined(faces), _joined(barycentrics), _joined(pixels), poses, (len(cameras), height, width))


def _joined(parts: list[Tensor]) -> Tensor:
    """All of them one after the other, and none left in the list: of 100 large views they take gigabytes."""
    joined = torch.cat(parts)
    parts.clear()
    return joined


class SurfaceInterpolator:
    """Turns what a G-buffer holds into points of the surface, with normals and texture coordinates.

    Attributes:
        offset: How far a point is lifted off its triangle before a ray leaves it, in scene units.
        geometric: (F, 3), the unit normals of the triangles, as they are wound.
        points: How many points it has made so far ...
        bent_normals: ... and of how many the shading normal faced away from the viewer and was bent to grazing.
    """

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        corners = torch.from_numpy(mesh.faces).long()
        position = torch.from_numpy(mesh.vertices)[corners]
        normal = torch.from_numpy(mesh.normals)[corners]
        uv = torch.from_numpy(mesh.uv)[corners]
        self.device = device
        self._vectors = torch.cat([position, normal], 1).to(device)  # (F, 6, 3)
        self._uv = uv.contiguous().to(device)
        places = position.reshape(-1, 3)
        extent = float((places.amax(0) - places.amin(0)).norm())
        rounding = torch.finfo(places.dtype).eps * float(places.abs().max())  # of a place, which far from the origin is more
        self.offset = max(1e-4 * extent, 4 * rounding)
        unit = 2.0 ** -round(math.log2(extent)) if extent > 0 else 1.0  # areas of a scene in small units would underflow
        edges = unit * (position[:, 1:] - position[:, :1])
        self.geometric = normalize(torch.linalg.cross(edges[:, 0], edges[:, 1])).to(device)
        self.points = self.bent_normals = 0

    @cached_property
    def area_per_uv(self) -> Tensor:
        """(F,), of each face, in squared scene units over the unit square of texture coordinates."""
        corner, across = self._vectors[:, :3], self._uv
        first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
        flat = torch.linalg.det(torch.stack([across[:, 1] - across[:, 0], across[:, 2] - across[:, 0]], 1)).abs()
        return torch.linalg.cross(first, second).norm(dim=1) / flat.clamp_min(1e-20)

    def uv(self, face: Tensor, barycentric: Tensor) -> Tensor:
        """Texture coordinates (..., 2) of (...,) faces >= 0 and (..., 2) barycentrics."""
        found = torch.empty_like(barycentric)
        parts = zip(*(each.split(PIXELS_AT_ONCE) for each in (face, barycentric, found)), strict=True)
        for corners, inner, into in parts:
            first, *others = self._uv.index_select(0, corners.reshape(-1)).reshape(*corners.shape, 3, 2).unbind(-2)
            into[:] = first
            for other, weight in zip(others, inner.split(1, -1), strict=True):
                into += weight * (other - first)
        return found

    def averaged(self, face: Tensor, barycentric: Tensor, texture: Tensor) -> Tensor:
        """The mean of a texture (H, W, C) over the points of (P, S) faces and (P, S, 2) barycentrics: (P, C).

        A face of -1 is a miss, which is one of the S points and adds nothing.
        """
        found = torch.zeros(len(face), texture.shape[-1], device=self.device)
        launch(average, len(face), face, barycentric, self._uv, texture.contiguous(), found, device=self.device)
        return found

    def geometry(self, face: Tensor, barycentric: Tensor) -> tuple[Tensor, Tensor]:
        """Unit normal of the triangle (as it is wound) and position of (N,) points, each (N, 3)."""
        weights = torch.cat([1 - barycentric.sum(-1, keepdim=True), barycentric], -1)
        return self.geometric[face], (self._vectors[face, :3] * weights[..., None]).sum(-2)

    def landed(self, direction: Tensor, face: Tensor, barycentric: Tensor, atlas: Tensor) -> Tensor:
        """The texels of a square ``atlas`` (A, A) int32 at which rays along ``direction`` (N, K, 3) end, (N, K) int32.

        ``face`` (N, K), -1 for a miss, and ``barycentric`` (N, K, 2) are what they hit. -1 for a miss and for the back of a
        triangle, which sends nothing.
        """
        texel = torch.empty(face.shape, dtype=torch.int32, device=self.device)
        launch(
            land, face.numel(), direction.reshape(-1, 3).contiguous(), face.reshape(-1), barycentric.reshape(-1, 2), self.geometric,
            self._uv, atlas.reshape(-1), len(atlas), texel.reshape(-1), device=self.device,
        )  # fmt: skip
        return texel

    def lifted(self, points: SurfacePoints) -> Tensor:
        """Where rays leave the points, (N, 3): beside their triangles, so that these are not met again."""
        return points.position + self.offset * points.geometric

    def __call__(self, face: Tensor, barycentric: Tensor, camera_centre: Tensor) -> SurfacePoints:
        """Points of (N,) faces, (N, 2) barycentrics, seen from (N, 3) camera centres.

        A face of -1 is a miss: it gets some point of triangle 0 and is not counted. A triangle seen from behind is turned
        over. A shading normal that faces away from the viewer although its triangle does not (a silhouette of a coarse
        mesh) is bent to grazing; ``bent_normals`` counts these.
        """
        count = len(face)
        position, normal, view, geometric = (torch.empty(count, 3, device=self.device) for _ in range(4))
        uv, flags = torch.empty(count, 2, device=self.device), torch.empty(count, 2, dtype=torch.uint8, device=self.device)
        launch(
            interpolate, count, face.int(), barycentric.contiguous(), camera_centre.contiguous(), self._vectors, self._uv,
            self.geometric, position, normal, view, geometric, uv, flags, device=self.device,
        )  # fmt: skip
        self.points += int((face >= 0).sum())
        self.bent_normals += int(flags[:, 1].sum())
        return SurfacePoints(position, normal, view, uv, geometric, flags[:, :1].bool())


def sees(cameras: list[Camera], positions: Tensor, normals: Tensor, rays: RayCaster, offset: float) -> Tensor:
    """Which cameras see which surface points well: (N, V) bool for (N, 3) positions with normals.

    Inside the image, at a cosine of at least GRAZING, and nothing between; ``offset``: of the shadow rays, scene units.
    """
    found = torch.zeros(len(positions), len(cameras), dtype=torch.bool, device=positions.device)
    for index, camera in enumerate(cameras):
        toward = positions.new_tensor(camera.position) - positions
        far = toward.norm(dim=-1, keepdim=True)
        directions = toward / far
        column, row, depth = camera.project(positions)
        framed = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        candidates = torch.nonzero(framed & ((normals * directions).sum(-1) >= GRAZING))[:, 0]
        starts = positions[candidates] + offset * normals[candidates]
        found[candidates, index] = rays.intersect(starts, directions[candidates])[2] >= far[candidates, 0]
    return found
