"""Functions of the renderer's Warp kernels, called with tensors, so that they can be tested one by one."""

import torch
import warp as wp

from ia_bench.common.warp_launch import launch
from ia_bench.common.warp_math import turned, unit
from ia_bench.light import warp_latlong as light
from ia_bench.light.latlong import LatLongSampler, sampling_grid
from ia_bench.material import warp_brdf as brdf
from ia_bench.material.textures import fetch
from ia_bench.render.estimator import DirectionSamples
from ia_bench.render.gbuffer import SurfacePoints

CPU = torch.device("cpu")


@wp.kernel(enable_backward=False)
def _bins(first: int, normals: wp.array(dtype=wp.vec3), cells: wp.array(dtype=int)):
    n = first + wp.tid()
    cells[n] = light.normal_bin(normals[n])


@wp.kernel(enable_backward=False)
def _texels(
    first: int, tables: light.Tables, cells: wp.array(dtype=int), u: wp.array(dtype=wp.float64), texels: wp.array(dtype=int)
):
    n = first + wp.tid()
    texels[n] = light.sample_texel(tables, cells[n], u[n])


@wp.kernel(enable_backward=False)
def _densities(
    first: int, tables: light.Tables, cells: wp.array(dtype=int), texels: wp.array(dtype=int), found: wp.array(dtype=float)
):
    n = first + wp.tid()
    found[n] = light.density(tables, cells[n], texels[n])


@wp.kernel(enable_backward=False)
def _to_directions(
    first: int, texels: wp.array(dtype=int), u: wp.array(dtype=wp.vec2), heights: wp.array(dtype=wp.float32), width: int,
    found: wp.array(dtype=wp.vec3),
):  # fmt: skip
    n = first + wp.tid()
    found[n] = light.texel_to_direction(texels[n], u[n][0], u[n][1], heights, width)


@wp.kernel(enable_backward=False)
def _to_texels(first: int, directions: wp.array(dtype=wp.vec3), height: int, width: int, found: wp.array(dtype=int)):
    n = first + wp.tid()
    found[n] = light.direction_to_texel(directions[n], height, width)


@wp.kernel(enable_backward=False)
def _visible(
    first: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3), roughness: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec2), found: wp.array(dtype=wp.vec3),
):  # fmt: skip
    n = first + wp.tid()
    point = brdf.seen_point(normals[n], views[n], roughness[n] * roughness[n])
    found[n] = brdf.sample_visible_ggx(point, u[n][0], u[n][1])


@wp.kernel(enable_backward=False)
def _lobes(
    first: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3), incidents: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float), found: wp.array(dtype=wp.vec4),
):  # fmt: skip
    n = first + wp.tid()
    point = brdf.seen_point(normals[n], views[n], roughness[n] * roughness[n])
    lobe = brdf.lobe_towards(point, incidents[n], wp.dot(normals[n], incidents[n]))
    found[n] = wp.vec4(lobe.value, lobe.slope, lobe.grazing, lobe.pdf)


@wp.kernel(enable_backward=False)
def _frames(first: int, normals: wp.array(dtype=wp.vec3), found: wp.array2d(dtype=wp.vec3)):
    n = first + wp.tid()
    point = brdf.seen_point(normals[n], normals[n], 0.5)
    found[n, 0] = point.tangent
    found[n, 1] = point.bitangent


@wp.kernel(enable_backward=False)
def _turned(first: int, turns: wp.array(dtype=float), found: wp.array(dtype=wp.vec2)):
    n = first + wp.tid()
    found[n] = turned(turns[n])


@wp.kernel(enable_backward=False)
def _units(first: int, vectors: wp.array(dtype=wp.vec3), found: wp.array(dtype=wp.vec3)):
    n = first + wp.tid()
    found[n] = unit(vectors[n])


def _call(kernel: wp.Kernel, shape: torch.Size, width: int, *arguments: object) -> torch.Tensor:
    """What a kernel finds for every entry of ``shape``: ``width`` numbers, or an integer for 0."""
    count = shape.numel()
    found = torch.empty(count, dtype=torch.int32) if width == 0 else torch.empty(count, width)
    launch(kernel, count, *arguments, found.reshape(-1) if width == 1 else found, device=CPU)
    return found.long().reshape(shape) if width == 0 else found.reshape(*shape, *([width] if width > 1 else []))


def _flat(values: torch.Tensor, shape: torch.Size, *last: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return values.to(dtype).expand(*shape, *last).reshape(-1, *last).contiguous()


def normal_bin(normal: torch.Tensor) -> torch.Tensor:
    """The cell (...,) of each unit normal (..., 3)."""
    shape = normal.shape[:-1]
    return _call(_bins, shape, 0, _flat(normal, shape, 3))


def sample_texel(sampler: LatLongSampler, cell: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Texels drawn by float64 ``u`` (...,) for cells that broadcast."""
    cells = _flat(cell, u.shape, dtype=torch.int32)
    return _call(_texels, u.shape, 0, light.tables_of(sampler), cells, _flat(u, u.shape, dtype=torch.float64))


def density(sampler: LatLongSampler, cell: torch.Tensor, texel: torch.Tensor) -> torch.Tensor:
    """Density per steradian of texels for cells; both broadcast."""
    shape = torch.broadcast_shapes(cell.shape, texel.shape)
    cells, texels = (_flat(values, shape, dtype=torch.int32) for values in (cell, texel))
    return _call(_densities, shape, 1, light.tables_of(sampler), cells, texels)


def texel_to_direction(texel: torch.Tensor, u: torch.Tensor, v: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Directions (..., 3) at ``u``, ``v`` in [0, 1) of texels."""
    inside = torch.stack([u, v], -1).float().reshape(-1, 2).contiguous()
    heights = sampling_grid(height, width, CPU).heights
    return _call(_to_directions, texel.shape, 3, _flat(texel, texel.shape, dtype=torch.int32), inside, heights, width)


def direction_to_texel(direction: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """The texel (...,) of unit directions (..., 3)."""
    shape = direction.shape[:-1]
    return _call(_to_texels, shape, 0, _flat(direction, shape, 3), height, width)


def sample_visible_ggx(normal: torch.Tensor, view: torch.Tensor, roughness: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """As :func:`ia_bench.material.brdf.sample_visible_ggx`."""
    shape = torch.broadcast_shapes(normal.shape, view.shape, (*u.shape[:-1], 3))[:-1]
    points = _flat(normal, shape, 3), _flat(view, shape, 3), _flat(roughness[..., 0], shape)
    return _call(_visible, shape, 3, *points, _flat(u, shape, 2))


def lobe(normal: torch.Tensor, view: torch.Tensor, incident: torch.Tensor, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """The four numbers of :class:`ia_bench.material.warp_brdf.Lobe`, each (..., 1): value, slope, grazing part and density."""
    shape = torch.broadcast_shapes(normal.shape, view.shape, incident.shape)[:-1]
    vectors = (_flat(vector, shape, 3) for vector in (normal, view, incident))
    return _call(_lobes, shape, 4, *vectors, _flat(roughness[..., 0], shape)).split(1, -1)


def tangent_frame(normal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tangent and bitangent of normals (N, 3)."""
    found = torch.empty(len(normal), 2, 3)
    launch(_frames, len(normal), normal.contiguous(), found, device=CPU)
    return found[:, 0], found[:, 1]


def turn(turns: torch.Tensor) -> torch.Tensor:
    """Cosine and sine of 2 pi ``turns`` (N,): (N, 2)."""
    return _call(_turned, turns.shape, 2, turns.contiguous())


def normalize(vectors: torch.Tensor) -> torch.Tensor:
    """Unit vectors of (N, 3)."""
    return _call(_units, vectors.shape[:-1], 3, vectors.contiguous())


def samples_of(
    surface: SurfacePoints, direction: torch.Tensor, texel: torch.Tensor, weight: torch.Tensor, roughness: torch.Tensor
) -> DirectionSamples:
    """What the estimator would have drawn, for directions (N, K, 3), texels (N, K) and weights (N, K, 1) of one's own.

    ``roughness``: the texture (T, T, 1). Weights of the second half count for themselves alone.
    """
    normal, view = surface.normal[:, None], surface.view[:, None]
    value, slope, grazing, pdf = lobe(normal, view, direction, fetch(roughness, surface.uv)[:, None].expand(*texel.shape, 1))
    cosine = (normal * direction).sum(-1, keepdim=True)
    lit = (cosine > 0) & (weight > 0)
    terms = torch.cat([cosine * weight, value * weight, slope * weight, grazing], -1)
    count = texel.shape[1] // 2
    boost = (1 / (count * weight.clamp_min(1e-12) * pdf.clamp_min(1e-12)))[:, count:, 0].contiguous()
    return DirectionSamples(direction, torch.where(lit[..., 0], texel, -1).int(), torch.where(lit, terms, 0).contiguous(), boost)
