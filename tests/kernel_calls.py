"""Functions of the renderer's Warp kernels, called with tensors, so that they can be tested one by one."""

import math

import torch
import warp as wp

from ia_bench.common.native import MATH, WIDTH, native
from ia_bench.common.warp_launch import launch
from ia_bench.common.warp_math import unit
from ia_bench.light.latlong import LatLongSampler
from ia_bench.light.warp_latlong import DIRECTIONS, SAMPLING, Tables, tables_of
from ia_bench.material.textures import fetch
from ia_bench.material.warp_brdf import BRDF
from ia_bench.render.estimator import DirectionSamples
from ia_bench.render.gbuffer import SurfacePoints

CPU = torch.device("cpu")


def _kernel_of(code: str) -> wp.Kernel:
    """A kernel that runs native ``code`` for vectors a, b and c, numbers u (float64), and whole numbers i and j, of every item."""

    @wp.func_native(native(WIDTH, LANES=1) + MATH + DIRECTIONS + SAMPLING + BRDF + code)
    def run(tables: Tables, a: wp.vec3, b: wp.vec3, c: wp.vec3, u: wp.vec3d, i: int, j: int) -> wp.vec4: ...

    @wp.kernel(enable_backward=False)
    def kernel(
        first: int, tables: Tables, a: wp.array(dtype=wp.vec3), b: wp.array(dtype=wp.vec3), c: wp.array(dtype=wp.vec3),
        u: wp.array(dtype=wp.vec3d), i: wp.array(dtype=int), j: wp.array(dtype=int), found: wp.array(dtype=wp.vec4),
    ):  # fmt: skip
        n = first + wp.tid()
        found[n] = run(tables, a[n], b[n], c[n], u[n], i[n], j[n])

    return kernel


_POINT = "const Seen point = seen_point(Vec(a[0], a[1], a[2]), Vec(b[0], b[1], b[2]), (float)(u[0] * u[0]));"
_VECTOR = "return wp::vec4(found.x, found.y, found.z, 0.0f);"
_BIN = _kernel_of("return wp::vec4((float)normal_bin(Vec(a[0], a[1], a[2])));")
_TEXEL = _kernel_of("const double at = u[0]; int found; sample_texels(&i, &at, &found); return wp::vec4((float)found);")
_DENSITY = _kernel_of("return wp::vec4(density(i, j));")
_TO_DIRECTION = _kernel_of(
    f"const Vec found = texel_to_direction(j, (float)u[0], (float)u[1], tables.heights.data, tables.width); {_VECTOR}"
)
_TO_TEXEL = _kernel_of("return wp::vec4((float)direction_to_texel(Vec(a[0], a[1], a[2]), tables.height, tables.width));")
_VISIBLE = _kernel_of(f"{_POINT} const Vec found = sample_visible_ggx(point, (float)u[1], (float)u[2]); {_VECTOR}")
_LOBE = _kernel_of(f"""{_POINT}
    const Vec direction(c[0], c[1], c[2]);
    const Lobe lobe = lobe_towards(point, direction, point.normal.dot(direction));
    return wp::vec4(lobe.value, lobe.slope, lobe.grazing, lobe.pdf);""")
_AXIS = _kernel_of(f"{_POINT} const Vec found = i ? point.bitangent : point.tangent; {_VECTOR}")


def _call(kernel: wp.Kernel, shape: torch.Size, tables: "Tables | None" = None, **given: torch.Tensor) -> torch.Tensor:
    """The four numbers (..., 4) that a kernel finds for every entry of ``shape``, of what is ``given``, which broadcasts."""
    kinds = {name: ((3,), torch.float32) for name in "abc"} | {"u": ((3,), torch.float64)} | dict.fromkeys("ij", ((), torch.int32))
    inputs = []
    for name, (last, dtype) in kinds.items():
        values = given.get(name, torch.zeros(last)).to(dtype)
        if last:
            values = torch.nn.functional.pad(values, (0, 3 - values.shape[-1]))
        inputs.append(values.expand((*shape, *last)).reshape(-1, *last).contiguous())
    found = torch.empty(shape.numel(), 4)
    launch(kernel, len(found), tables or Tables(), *inputs, found, device=CPU)
    return found.reshape(*shape, 4)


def _map_of(height: int, width: int) -> Tables:
    """What kernels know of a map by its size alone."""
    tables = Tables()
    tables.height, tables.width = height, width
    tables.heights = wp.from_torch(torch.cos(torch.arange(height + 1, dtype=torch.float64) * (math.pi / height)).float())
    return tables


def normal_bin(normal: torch.Tensor) -> torch.Tensor:
    """The cell (...,) of each unit normal (..., 3)."""
    return _call(_BIN, normal.shape[:-1], a=normal)[..., 0].long()


def sample_texel(sampler: LatLongSampler, cell: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Texels drawn by float64 ``u`` (...,) for cells that broadcast."""
    return _call(_TEXEL, u.shape, tables_of(sampler), i=cell, u=u[..., None])[..., 0].long()


def density(sampler: LatLongSampler, cell: torch.Tensor, texel: torch.Tensor) -> torch.Tensor:
    """Density per steradian of texels for cells; both broadcast."""
    return _call(_DENSITY, torch.broadcast_shapes(cell.shape, texel.shape), tables_of(sampler), i=cell, j=texel)[..., 0]


def texel_to_direction(texel: torch.Tensor, u: torch.Tensor, v: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Directions (..., 3) at ``u``, ``v`` in [0, 1) of texels."""
    return _call(_TO_DIRECTION, texel.shape, _map_of(height, width), j=texel, u=torch.stack([u, v], -1))[..., :3]


def direction_to_texel(direction: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """The texel (...,) of unit directions (..., 3)."""
    return _call(_TO_TEXEL, direction.shape[:-1], _map_of(height, width), a=direction)[..., 0].long()


def sample_visible_ggx(normal: torch.Tensor, view: torch.Tensor, roughness: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """As :func:`ia_bench.material.brdf.sample_visible_ggx`."""
    shape = torch.broadcast_shapes(normal.shape, view.shape, (*u.shape[:-1], 3))[:-1]
    numbers = torch.cat([part.expand(*shape, part.shape[-1]) for part in (roughness, u)], -1)
    return _call(_VISIBLE, shape, a=normal, b=view, u=numbers)[..., :3]


def lobe(normal: torch.Tensor, view: torch.Tensor, incident: torch.Tensor, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """The four numbers of :class:`ia_bench.material.warp_brdf.Lobe`, each (..., 1): value, slope, grazing part and density."""
    shape = torch.broadcast_shapes(normal.shape, view.shape, incident.shape)[:-1]
    return _call(_LOBE, shape, a=normal, b=view, c=incident, u=roughness).split(1, -1)


def tangent_frame(normal: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Tangent and bitangent of normals (N, 3)."""
    return tuple(_call(_AXIS, normal.shape[:-1], a=normal, b=normal, i=torch.tensor(second))[..., :3] for second in (0, 1))


@wp.kernel(enable_backward=False)
def _units(first: int, vectors: wp.array(dtype=wp.vec3), found: wp.array(dtype=wp.vec3)):
    n = first + wp.tid()
    found[n] = unit(vectors[n])


def normalize(vectors: torch.Tensor) -> torch.Tensor:
    """Unit vectors of (N, 3)."""
    found = torch.empty_like(vectors)
    launch(_units, len(vectors), vectors.contiguous(), found, device=CPU)
    return found


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
