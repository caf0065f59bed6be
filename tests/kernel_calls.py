"""Functions of the renderer's Warp kernels, called with tensors, so that they can be tested one by one."""

import torch
import warp as wp

from ia_bench.common.native import MATH
from ia_bench.common.warp_launch import launch
from ia_bench.common.warp_math import unit
from ia_bench.light.latlong import LatLongSampler, sampling_grid
from ia_bench.light.warp_latlong import DIRECTIONS, SAMPLING, Tables, tables_of
from ia_bench.light.warp_latlong import direction_to_texel as direction_to_texel_of
from ia_bench.material.textures import fetch
from ia_bench.material.warp_brdf import BRDF
from ia_bench.render.estimator import DirectionSamples
from ia_bench.render.gbuffer import SurfacePoints

CPU = torch.device("cpu")


@wp.func_native(MATH + DIRECTIONS + "return normal_bin(Vec(normal[0], normal[1], normal[2]));")
def _bin(normal: wp.vec3) -> int: ...


@wp.kernel(enable_backward=False)
def _bins(first: int, normals: wp.array(dtype=wp.vec3), cells: wp.array(dtype=int)):
    n = first + wp.tid()
    cells[n] = _bin(normals[n])


@wp.func_native(MATH + SAMPLING + "return sample_texel(cell, u);")
def _texel(tables: Tables, cell: int, u: wp.float64) -> int: ...


@wp.kernel(enable_backward=False)
def _texels(first: int, tables: Tables, cells: wp.array(dtype=int), u: wp.array(dtype=wp.float64), texels: wp.array(dtype=int)):
    n = first + wp.tid()
    texels[n] = _texel(tables, cells[n], u[n])


@wp.func_native(MATH + SAMPLING + "return density(cell, texel);")
def _density(tables: Tables, cell: int, texel: int) -> float: ...


@wp.kernel(enable_backward=False)
def _densities(first: int, tables: Tables, cells: wp.array(dtype=int), texels: wp.array(dtype=int), found: wp.array(dtype=float)):
    n = first + wp.tid()
    found[n] = _density(tables, cells[n], texels[n])


@wp.func_native(
    MATH + DIRECTIONS + "const Vec d = texel_to_direction(texel, u[0], u[1], heights.data, width); return wp::vec3(d.x, d.y, d.z);"
)
def _to_direction(texel: int, u: wp.vec2, heights: wp.array(dtype=wp.float32), width: int) -> wp.vec3: ...


@wp.kernel(enable_backward=False)
def _to_directions(
    first: int, texels: wp.array(dtype=int), u: wp.array(dtype=wp.vec2), heights: wp.array(dtype=wp.float32), width: int,
    found: wp.array(dtype=wp.vec3),
):  # fmt: skip
    n = first + wp.tid()
    found[n] = _to_direction(texels[n], u[n], heights, width)


@wp.kernel(enable_backward=False)
def _to_texels(first: int, directions: wp.array(dtype=wp.vec3), height: int, width: int, found: wp.array(dtype=int)):
    n = first + wp.tid()
    found[n] = direction_to_texel_of(directions[n], height, width)


_POINT = """
    const Seen point = seen_point(Vec(normal[0], normal[1], normal[2]), Vec(view[0], view[1], view[2]), roughness * roughness);
"""


@wp.func_native(MATH + BRDF + _POINT + "const Vec d = sample_visible_ggx(point, u[0], u[1]); return wp::vec3(d.x, d.y, d.z);")
def _visible_one(normal: wp.vec3, view: wp.vec3, roughness: float, u: wp.vec2) -> wp.vec3: ...


@wp.kernel(enable_backward=False)
def _visible(
    first: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3), roughness: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec2), found: wp.array(dtype=wp.vec3),
):  # fmt: skip
    n = first + wp.tid()
    found[n] = _visible_one(normals[n], views[n], roughness[n], u[n])


_LOBE = """
    const Vec direction(incident[0], incident[1], incident[2]);
    const Lobe lobe = lobe_towards(point, direction, point.normal.dot(direction));
    return wp::vec4(lobe.value, lobe.slope, lobe.grazing, lobe.pdf);
"""


@wp.func_native(MATH + BRDF + _POINT + _LOBE)
def _lobe(normal: wp.vec3, view: wp.vec3, roughness: float, incident: wp.vec3) -> wp.vec4: ...


@wp.kernel(enable_backward=False)
def _lobes(
    first: int, normals: wp.array(dtype=wp.vec3), views: wp.array(dtype=wp.vec3), incidents: wp.array(dtype=wp.vec3),
    roughness: wp.array(dtype=float), found: wp.array(dtype=wp.vec4),
):  # fmt: skip
    n = first + wp.tid()
    found[n] = _lobe(normals[n], views[n], roughness[n], incidents[n])


_FRAME = """
    const Vec axis = second ? point.bitangent : point.tangent;
    return wp::vec3(axis.x, axis.y, axis.z);
"""


@wp.func_native(MATH + BRDF + _POINT + _FRAME)
def _axis(normal: wp.vec3, view: wp.vec3, roughness: float, second: int) -> wp.vec3: ...


@wp.kernel(enable_backward=False)
def _frames(first: int, normals: wp.array(dtype=wp.vec3), found: wp.array2d(dtype=wp.vec3)):
    n = first + wp.tid()
    found[n, 0] = _axis(normals[n], normals[n], 0.5, 0)
    found[n, 1] = _axis(normals[n], normals[n], 0.5, 1)


@wp.func_native(MATH + "const Vec around = turned(turns); return wp::vec2(around.x, around.y);")
def _turned_by(turns: float) -> wp.vec2: ...


@wp.kernel(enable_backward=False)
def _turned(first: int, turns: wp.array(dtype=float), found: wp.array(dtype=wp.vec2)):
    n = first + wp.tid()
    found[n] = _turned_by(turns[n])


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
    return _call(_texels, u.shape, 0, tables_of(sampler), cells, _flat(u, u.shape, dtype=torch.float64))


def density(sampler: LatLongSampler, cell: torch.Tensor, texel: torch.Tensor) -> torch.Tensor:
    """Density per steradian of texels for cells; both broadcast."""
    shape = torch.broadcast_shapes(cell.shape, texel.shape)
    cells, texels = (_flat(values, shape, dtype=torch.int32) for values in (cell, texel))
    return _call(_densities, shape, 1, tables_of(sampler), cells, texels)


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
