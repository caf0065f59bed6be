"""Light that the object throws onto itself: radiosity between the texels of its atlas, baked once per mesh.

Diffuse interreflection is linear in the light and in the radiance that leaves the surface: with ``S`` the irradiance of a
texel per unit radiance of the sky's cells, and ``X`` that per unit radiance of the other texels,

    E_direct = S L,    E_indirect = X (albedo / pi) (E_direct + E_indirect)

(the radiosity equation; Goral et al. 1984). ``S`` and ``X`` are traced once along stratified directions from every texel; the
equation is solved anew, by one Jacobi iteration a bounce, whenever albedo or light have changed, and is differentiable in
both. What it leaves out: light that leaves a surface is spread as by a diffuse one, though it may come from a mirror or a
metal, and the backs of open sheets neither send nor receive indirect light.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key, made_on
from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import direction_to_texel, row_solid_angles, texel_to_direction
from ia_bench.material.brdf import dot
from ia_bench.material.textures import fetch
from ia_bench.render.control import ControlAtPoints, DiffuseControl
from ia_bench.render.estimator import FromObject
from ia_bench.render.gbuffer import SurfaceInterpolator, SurfacePoints
from ia_bench.render.rays import EmbreeRays, RayCaster
from ia_bench.scenes.scene import Mesh

ATLAS_SIZE = 128  # texels along a side of the atlas between whose texels a fit exchanges light
SKY_ROWS = 16  # rows of the lat-long grid of directions; twice as many columns
CELL_POINTS = 4  # along a side of such a cell, at which a light that is turned is looked up ...
TURNED_ROWS = 32  # ... in a map of no more rows, whose texels such points do not miss
BAKE_CHUNK = 1024  # texels traced at once
VERSION = 2  # of what is kept of a bake
ATLAS_PARTS = ("place", "face", "barycentric", "row")
BURIED = 0.3  # a texel that sees more backs of triangles than this (cosine-weighted) lies inside the object


@dataclass(frozen=True)
class Atlas:
    """The N texels of a square atlas whose centres lie on a triangle.

    ``place`` (N,) int64: flat index in the atlas; ``face`` (N,) int64 and ``barycentric`` (N, 2): the point on the mesh.
    ``row`` (size, size) int32: which of the N stands for a texel of the atlas, the nearest where the texel is none itself.
    """

    place: Tensor
    face: Tensor
    barycentric: Tensor
    row: Tensor

    @classmethod
    def of(cls, mesh: Mesh, size: int, device: torch.device) -> Atlas:
        """The texels that rays through the UV plane find."""
        flat = np.concatenate([mesh.uv, np.zeros_like(mesh.uv[:, :1])], 1)
        plane = EmbreeRays(Mesh(flat, mesh.faces, mesh.normals, mesh.uv))
        centres = (np.arange(size, dtype=np.float32) + 0.5) / size
        v, u = np.meshgrid(1 - centres, centres, indexing="ij")
        origins = torch.from_numpy(np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3).astype(np.float32))
        face, barycentric, _ = plane.intersect(origins, torch.tensor([0.0, 0.0, -1.0]).expand_as(origins).contiguous())
        place = torch.nonzero(face >= 0)[:, 0]
        row = _nearest(place, torch.arange(len(place)), size)
        return cls(place.to(device), face[place].to(device), barycentric[place].to(device), row.to(device))

    def keeping(self, kept: Tensor) -> Atlas:
        """The same texels, but only those of ``kept`` (N,) bool are ever found by a lookup; none kept changes nothing."""
        which = torch.nonzero(kept)[:, 0]
        if len(which) == 0:
            return self
        return replace(self, row=_nearest(self.place[which].cpu(), which.cpu(), len(self.row)).to(self.row.device))

    def nearest(self, uv: Tensor) -> Tensor:
        """The texel at (..., 2) texture coordinates: (...,) int32 in [0, N)."""
        size = len(self.row)
        column = (uv[..., 0] * size).long().clamp(0, size - 1)
        row = ((1 - uv[..., 1]) * size).long().clamp(0, size - 1)
        return self.row[row, column]


def _nearest(place: Tensor, texel: Tensor, size: int) -> Tensor:
    """For every texel of the atlas the one of ``texel`` (M,), which lie at ``place`` (M,), that is nearest: (size, size)."""
    from scipy.ndimage import distance_transform_edt

    row_of = np.zeros(size * size, np.int32)
    covered = np.zeros(size * size, bool)
    row_of[place.numpy()], covered[place.numpy()] = texel.numpy(), True
    nearest = distance_transform_edt(~covered.reshape(size, size), return_distances=False, return_indices=True)
    return torch.from_numpy(row_of.reshape(size, size)[tuple(nearest)])


def mesh_key(kind: str, mesh: Mesh, *sizes: int, device: torch.device) -> str:
    """The key under which a cache keeps what is baked on the ``device`` for the atlas of a mesh."""
    return content_key(made_on(device.type, kind), " ".join(map(str, sizes)), mesh.vertices, mesh.faces, mesh.uv)


class Operator:
    """A fixed sparse matrix (rows, columns), kept by rows; its transpose likewise, as soon as a gradient asks for it."""

    def __init__(self, matrix: Tensor) -> None:
        """``matrix`` may be dense or sparse."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta state", category=UserWarning)
            rows = matrix.to_sparse_csr()
            indices = rows.crow_indices().int(), rows.col_indices().int()  # others are converted to 32 bits with every product
            self.matrix = torch.sparse_csr_tensor(*indices, rows.values(), rows.shape, check_invariants=True)

    @cached_property
    def transposed(self) -> Operator:
        """The operator of the transpose."""
        return Operator(self.matrix.t())

    def apply(self, values: Tensor) -> Tensor:
        """The matrix times values (columns, C): (rows, C). Differentiable in the values."""
        product: Tensor = _Product.apply(values, self)
        return product


@dataclass(eq=False)
class Interreflection:
    """The baked operators of one mesh; :func:`bake_interreflection` makes them."""

    atlas: Atlas
    sky: Operator  # S, (N, cells)
    exchange: Operator  # X, (N, N)
    surface: SurfaceInterpolator
    rays: RayCaster
    bounces: int  # reflections between light and the point that is seen, at least 1
    control: DiffuseControl | None = None
    _lookup: tuple[object, Operator] | None = None  # of the sky's cells in a light that was turned last

    @cached_property
    def uv(self) -> Tensor:
        """Texture coordinates of the texels, (N, 2)."""
        return self.surface.uv(self.atlas.face, self.atlas.barycentric)

    def solve(self, albedo: Tensor, radiance: Tensor, turns: Tensor | None = None) -> IndirectLight:
        """The balance under a light ``radiance`` (H, W, 3) with ``albedo`` (T, T, 3); differentiable in both.

        ``turns`` (K, 3, 3): of the light as each of these rotations finds it, that of direction d at R d; texels of each one
        after another, (K N, 3).
        """
        sky = _cells(radiance) if turns is None else self._turned_cells(radiance, turns)
        direct = self.sky.apply(sky)
        reflectance = fetch(albedo, self.uv).repeat(1, direct.shape[1] // 3) / math.pi
        indirect = torch.zeros_like(direct)
        for _ in range(self.bounces):
            indirect = self.exchange.apply(reflectance * (direct + indirect))
        found = indirect, reflectance * (direct + indirect)
        if turns is not None:
            return IndirectLight(self, *(each.unflatten(1, (-1, 3)).transpose(0, 1).reshape(-1, 3) for each in found))
        return IndirectLight(self, *found, sky)

    def _turned_cells(self, radiance: Tensor, turns: Tensor) -> Tensor:
        """:func:`_cells` of a map that is turned, (cells, 3 K): the mean over CELL_POINTS^2 points of each cell."""
        if len(radiance) > TURNED_ROWS:
            radiance = LatLongEnvironment(radiance).latlong(TURNED_ROWS)
        height, width, _ = radiance.shape
        key = height, turns.cpu().numpy().tobytes()
        if self._lookup is None or self._lookup[0] != key:
            cells = torch.arange(2 * SKY_ROWS * SKY_ROWS)[:, None]
            down, across = ((torch.arange(CELL_POINTS**2) // part % CELL_POINTS + 0.5) / CELL_POINTS for part in (CELL_POINTS, 1))
            directions = texel_to_direction(cells, down, across, SKY_ROWS, 2 * SKY_ROWS).reshape(-1, 3).to(turns)
            texel = direction_to_texel(directions @ turns.transpose(1, 2), height, width).reshape(-1)
            cell = torch.arange(len(turns) * len(cells), device=texel.device).repeat_interleave(CELL_POINTS**2)
            shares = torch.full(texel.shape, 1 / CELL_POINTS**2, device=texel.device)
            size = len(turns) * len(cells), height * width
            matrix = torch.sparse_coo_tensor(torch.stack([cell, texel]), shares, size, check_invariants=True).coalesce()
            self._lookup = key, Operator(matrix)
        found = self._lookup[1].apply(radiance.reshape(-1, 3))
        return found.unflatten(0, (len(turns), -1)).transpose(0, 1).reshape(-1, 3 * len(turns))

    def seen(self, points: SurfacePoints, direction: Tensor, blocked: Tensor) -> Tensor:
        """The texels of the object on which directions (N, K, 3) end, (N, K) int32, -1 for none.

        ``blocked`` (N, K) bool says in whose way the object is.
        """
        face, barycentric, _ = self.rays.intersect(self.surface.lifted(points), direction, blocked)
        return self.surface.landed(direction, face, barycentric, self.atlas.row)


class IndirectLight(NamedTuple):
    """What the object throws onto itself, at the N texels of its atlas, and the light that this was found from."""

    baked: Interreflection
    arriving: Tensor  # (N, 3), the irradiance from the object itself
    leaving: Tensor  # (N, 3), the radiance that the texels send out
    sky: Tensor | None = None  # (cells, 3), the mean radiance of the light in each cell of the sky; None where the light turns
    first: Tensor | None = None  # where it turns, the row at which the texels that each view sees begin, (V,) int32

    def seen_by(self, view: Tensor | None, seen: Tensor) -> FromObject:
        """The same for points of the views ``view`` (N,), whose directions by the BRDF see the texels ``seen`` (N, count)."""
        if self.first is None or view is None:
            return FromObject(self.arriving, self.leaving, self.baked.atlas.row, seen)
        first = self.first[view]
        seen = torch.where(seen < 0, seen, seen + first[:, None])
        return FromObject(self.arriving, self.leaving, self.baked.atlas.row, seen, first)

    def control_at(self, points: SurfacePoints, hit: Tensor) -> ControlAtPoints | None:
        """The control variate of N points, of those that are ``hit``; None without one, and under a light that turns."""
        if self.baked.control is None or self.sky is None:
            return None
        row = torch.where(hit & points.front[:, 0], self.baked.atlas.nearest(points.uv), -1)  # texels see from the front
        return self.baked.control.at(self.sky, row, points.normal)


class _Product(torch.autograd.Function):
    """A sparse matrix times a dense one; the gradient is the transpose times its own."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, operator: Operator) -> Tensor:  # noqa: ANN401 (torch's context)
        ctx.operator = operator
        return operator.matrix @ values

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401 (torch's context)
        return _Product.apply(gradients[0].contiguous(), ctx.operator.transposed), None  # which can be differentiated again


def _cells(radiance: Tensor) -> Tensor:
    """Mean radiance of each of the sky's cells, weighted by solid angle: (H, W, 3) -> (cells, 3)."""
    height, width, _ = radiance.shape
    if any(max(sides) % min(sides) for sides in ((height, SKY_ROWS), (width, 2 * SKY_ROWS))):  # windows of pooling would overlap
        return LatLongEnvironment(radiance).latlong(SKY_ROWS).reshape(-1, 3)
    weight = row_solid_angles(height, width).to(radiance)[:, None].expand(height, width)
    grid = (SKY_ROWS, 2 * SKY_ROWS)
    power = torch.nn.functional.adaptive_avg_pool2d((radiance * weight[..., None]).permute(2, 0, 1), grid)
    return (power / torch.nn.functional.adaptive_avg_pool2d(weight[None], grid)).permute(1, 2, 0).reshape(-1, 3)


def bake_interreflection(
    surface: SurfaceInterpolator, rays: RayCaster, bounces: int, *, atlas_size: int = ATLAS_SIZE, controlled: bool = False
) -> Interreflection:
    """Trace the operators of a mesh, or read them from the cache; ``controlled``: with a control variate of diffuse light.

    Raises InputError where the mesh has no atlas to speak of.
    """

    def trace() -> dict[str, Tensor]:
        atlas = Atlas.of(rays.mesh, atlas_size, surface.device)
        if len(atlas.face) == 0:
            raise InputError(
                f"render.bounces={bounces}: expected texture coordinates that cover a part of the texture, found none of "
                f"{atlas_size} x {atlas_size} texels on a triangle; reader.options.uv=xatlas makes some"
            )
        return _trace(atlas, surface, rays)

    key = mesh_key("interreflection", rays.mesh, VERSION, atlas_size, SKY_ROWS, device=surface.device)
    traced = Cache().kept(key, trace)
    atlas = Atlas(**{part: traced[part].to(surface.device) for part in ATLAS_PARTS})
    size = (len(atlas.face), len(atlas.face))
    pairs = torch.stack([traced["to_texel"], traced["from_texel"]]).long()
    exchange = torch.sparse_coo_tensor(pairs, traced["share"], size, check_invariants=True, is_coalesced=True)
    sky = traced["sky"].to(surface.device).float()
    control = DiffuseControl(sky > 0, SKY_ROWS) if controlled else None
    return Interreflection(atlas, Operator(sky), Operator(exchange.to(surface.device)), surface, rays, bounces, control)


def _trace(atlas: Atlas, surface: SurfaceInterpolator, rays: RayCaster) -> dict[str, Tensor]:
    """``sky`` (N, cells) float16, X as ``share`` (E,) float32 of pairs ``to_texel``, ``from_texel``, and ATLAS_PARTS.

    No texel inside the object is found in that atlas. One direction is traced in each cell above the triangle, weighted by cosine
    and solid angle; the weights of a texel sum to pi.
    """
    device, count = surface.device, len(atlas.face)
    cells = torch.arange(2 * SKY_ROWS * SKY_ROWS)
    solid_angle = row_solid_angles(SKY_ROWS, 2 * SKY_ROWS).float().repeat_interleave(2 * SKY_ROWS).to(device)
    generator = torch.Generator().manual_seed(0)
    sky = torch.zeros(count, len(cells), device=device)
    backs = torch.zeros(count, device=device)
    pairs: list[tuple[Tensor, Tensor, Tensor]] = []  # texel, weight, and where the ray ended, of rays that ended on a front
    for texel in torch.arange(count, device=device).split(BAKE_CHUNK):
        normal, position = surface.geometry(atlas.face[texel], atlas.barycentric[texel])
        down, across = torch.rand(2, len(texel), len(cells), generator=generator)
        direction = texel_to_direction(cells.expand(len(texel), -1), down, across, SKY_ROWS, 2 * SKY_ROWS).to(device)
        weight = dot(normal[:, None], direction)[..., 0].clamp_min(0) * solid_angle
        weight *= math.pi / weight.sum(1, keepdim=True).clamp_min(1e-12)
        which, cell = torch.nonzero(weight, as_tuple=True)
        direction, weight = direction[which, cell], weight[which, cell]
        face, barycentric, _ = rays.intersect((position + surface.offset * normal)[which], direction)
        missed = face < 0
        sky[texel[which[missed]], cell[missed]] = weight[missed]
        front = ~missed & (dot(surface.geometry(face.clamp_min(0), barycentric)[0], direction)[:, 0] < 0)
        backs.index_add_(0, texel[which], weight * (~missed & ~front))
        pairs.append((texel[which[front]], weight[front], surface.uv(face[front], barycentric[front])))
    buried = backs > BURIED * math.pi
    to_texel, share, uv = (torch.cat(parts) for parts in zip(*pairs, strict=True))
    seen = atlas.keeping(~buried)
    from_texel = seen.nearest(uv)
    matrix = torch.sparse_coo_tensor(torch.stack([to_texel, from_texel]), share, (count, count), check_invariants=True).coalesce()
    return {
        "sky": sky.half().cpu(),
        "to_texel": matrix.indices()[0].int().cpu(),
        "from_texel": matrix.indices()[1].int().cpu(),
        "share": matrix.values().cpu(),
        **{part: getattr(seen, part).cpu() for part in ATLAS_PARTS},
    }
