"""Rays against a fixed mesh: Embree on the CPU, Warp on CUDA (it also runs on the CPU, where the tests compare the two)."""

from __future__ import annotations

import ctypes
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_uint, c_void_p
from functools import cache
from pathlib import Path

import numpy as np
import torch
import warp as wp
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.warp_launch import launch
from ia_bench.scenes.scene import Mesh

BLOCK = 128  # rays of a kernel's item: those of them that are asked for fill its packets
TRIANGLES, INDICES, VERTICES, UINT3, FLOAT3 = 0, 0, 1, 0x5003, 0x9003  # Embree's enumerations
FILTERED = 1 << 3  # a scene whose queries may bring a filter
FAR = 1e30


def make_rays(mesh: Mesh, device: torch.device) -> RayCaster:
    """The exact tracer of the device."""
    return EmbreeRays(mesh) if device.type == "cpu" else WarpRays(mesh, device)


class RayCaster:
    """A ray tracer.

    Attributes:
        mesh: The triangles that it traces.
        rays: How many rays it has traced so far.
    """

    _kernel: wp.Kernel
    _block = 1  # rays of an item of that kernel
    _scene: int  # the handle of what the kernel asks ...
    _triangles: tuple[Tensor | None, Tensor | None] = (None, None)  # vertices and corners, where the kernel asks for them
    _queries: tuple[int | None, int | None] = (0, 0)  # ... and of how: whether there is a hit, and which is nearest

    def __init__(self, mesh: Mesh) -> None:
        self.mesh, self.rays = mesh, 0

    def intersect(
        self, origins: Tensor, directions: Tensor, asked: Tensor | None = None, *, coherent: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Nearest hits of rays, (N, 3) origins and directions.

        Returns the triangle (N,) int64, -1 for a miss; the barycentrics (N, 2) of corners 1 and 2; the distance (N,), Inf
        for a miss, and by rounding less than 0 where a ray begins on a triangle. Or (N, K) of each for (N, K, 3) directions, K
        from every origin, of which only those are traced that are ``asked`` (N, K) bool for; the others count as misses.

        ``coherent`` says that rays that follow each other take nearly the same way, which some tracers find sooner.
        """
        shape, device = directions.shape[:-1], origins.device
        face = torch.full(shape, -1, dtype=torch.int32, device=device)
        barycentric, distance = torch.zeros(*shape, 2, device=device), torch.full(shape, torch.inf, device=device)
        self._trace(
            True, origins, directions, asked, coherent, face.reshape(-1), barycentric.reshape(-1, 2), distance.reshape(-1), None
        )
        return face.long(), barycentric, distance

    def occluded(self, origins: Tensor, directions: Tensor, asked: Tensor | None = None) -> Tensor:
        """Whether rays of infinite length hit anything: (N,) bool for (N, 3) origins and directions.

        Or (N, K) for (N, K, 3) directions, as :meth:`intersect` has them; those that are not asked for count as free.
        """
        blocked = torch.zeros(directions.shape[:-1], dtype=torch.uint8, device=origins.device)
        self._trace(False, origins, directions, asked, False, None, None, None, blocked.reshape(-1))
        return blocked.bool()

    def _trace(
        self, nearest: bool, origins: Tensor, directions: Tensor, asked: Tensor | None, coherent: bool, *results: Tensor | None
    ) -> None:
        """Fill triangles, barycentrics and distances of the ``nearest`` hits, or else, fourth, whether there is any hit."""
        count = directions.numel() // 3
        self.rays += count if asked is None else int(asked.sum())
        if count == 0:
            return
        mask = None if asked is None else asked.contiguous().view(torch.uint8).reshape(-1)
        launch(
            self._kernel, -(-count // self._block), int(nearest), self._queries[nearest], self._scene, origins.contiguous(),
            directions.contiguous().reshape(-1, 3), mask, int(coherent), *self._triangles, *results,
            device=origins.device,
        )  # fmt: skip


# ---------------- Embree ----------------


_PACKETS = """
#if !defined(__CUDA_ARCH__)
    const int W = 16;
    const int BLOCK = %BLOCK%;
    constexpr unsigned NOTHING = 0xffffffffu;
    constexpr double ROUNDING = 2e-6;
    struct alignas(64) Packet {
        float ox[W], oy[W], oz[W], near[W], dx[W], dy[W], dz[W], time[W], far[W];
        unsigned mask[W], id[W], flags[W];
        float nx[W], ny[W], nz[W], u[W], v[W];
        unsigned primitive[W], geometry[W], instance[2][W];
    };
    struct Arguments { unsigned flags, features; void *context, *filter, *function; };  // RTCIntersectArguments
    typedef void (*Query)(const int*, void*, void*, Arguments*);
    struct Hit { double distance, u, v; unsigned face; };
    struct Context { unsigned instance[4]; const wp::vec3* vertices; const int* corners; Hit hits[W]; };  // ours after Embree's
    struct Candidates { int* valid; void* user; Context* context; float *ray, *hit; unsigned count; };  // of Embree's filters
    auto nearer = [](const Candidates* found) {
        const unsigned N = found->count;  // of rays; Embree may ask about fewer than a packet has
        Context& context = *found->context;
        for (unsigned k = 0; k < N; ++k) {
            if (!found->valid[k]) continue;
            float* ray = found->ray + k;
            const unsigned face = ((unsigned*)found->hit)[5 * N + k];
            const wp::vec3d o(ray[0], ray[N], ray[2 * N]), d(ray[4 * N], ray[5 * N], ray[6 * N]);
            const wp::vec3d corner(context.vertices[context.corners[3 * face]]);
            const wp::vec3d along = wp::vec3d(context.vertices[context.corners[3 * face + 1]]) - corner;
            const wp::vec3d across = wp::vec3d(context.vertices[context.corners[3 * face + 2]]) - corner;
            const wp::vec3d sideways = wp::cross(d, across);
            const double determinant = wp::dot(along, sideways);
            double u = 0.0, v = 0.0, grazing = 0.0;
            if (determinant != 0.0) {
                grazing = wp::length(wp::cross(along, across)) / wp::abs(determinant);  // of a direction of unit length, 1 / cos
                u = wp::clamp(wp::dot(o - corner, sideways) / determinant, 0.0, 1.0);
                v = wp::clamp(wp::dot(d, wp::cross(o - corner, along)) / determinant, 0.0, 1.0 - u);
            }
            const double distance = wp::dot(corner + u * along + v * across - o, d) / wp::dot(d, d);
            Hit& best = context.hits[((unsigned*)ray)[10 * N]];
            if (best.face == NOTHING || distance < best.distance || (distance == best.distance && face < best.face)) {
                best = {distance, u, v, face};
                const double error = ROUNDING * (wp::length(o) + wp::length(o - corner)) * grazing;
                ray[8 * N] = (float)(distance + error);  // so that Embree's rounding keeps none from us
            } else {
                found->valid[k] = 0;
            }
        }
    };
    Context context;
    context.vertices = vertices.data;
    context.corners = corners.data;
    for (int k = 0; k < 4; ++k) context.instance[k] = NOTHING;
    Arguments arguments = {coherent ? 1u << 16 : 0u, 0xffffffffu, nullptr, nullptr, nullptr};
    if (nearest) {
        arguments.flags |= 1u << 1;  // the filter of these arguments is to be asked
        arguments.context = &context;
        arguments.filter = (void*)(void (*)(const Candidates*))nearer;
    }
    Packet packet;
    alignas(64) int valid[W];
    int which[W];
    int filled = 0;
    const int count = directions.shape[0], each = count / origins.shape[0];
    int end = (item + 1) * BLOCK < count ? (item + 1) * BLOCK : count;
    for (int i = item * BLOCK; i < end; ++i) {
        if (asked.shape[0] == 0 || asked[i]) {
            const int p = i / each;
            const wp::vec3 o = origins[p];
            const wp::vec3 d = directions[i];
            packet.ox[filled] = o[0]; packet.oy[filled] = o[1]; packet.oz[filled] = o[2];
            packet.dx[filled] = d[0]; packet.dy[filled] = d[1]; packet.dz[filled] = d[2];
            which[filled++] = i;
        }
        if (filled < W && (i + 1 < end || filled == 0)) continue;
        for (int k = 0; k < W; ++k) {
            if (k >= filled) {
                packet.ox[k] = packet.oy[k] = packet.oz[k] = 0.0f;
                packet.dx[k] = packet.dy[k] = packet.dz[k] = 1.0f;
            }
            packet.near[k] = packet.time[k] = 0.0f;
            packet.far[k] = __builtin_inff();
            packet.mask[k] = packet.geometry[k] = packet.instance[0][k] = packet.instance[1][k] = packet.primitive[k] = NOTHING;
            packet.id[k] = k;
            packet.flags[k] = 0u;
            context.hits[k].face = NOTHING;
            valid[k] = k < filled ? -1 : 0;
        }
        ((Query)query)(valid, (void*)scene, &packet, &arguments);
        for (int k = 0; k < filled; ++k) {
            const int n = which[k];
            if (!nearest) {
                blocked[n] = packet.far[k] < 0.0f ? 1 : 0;
            } else if (context.hits[k].face != NOTHING) {
                faces[n] = (int)context.hits[k].face;
                barycentrics[n] = wp::vec2((float)context.hits[k].u, (float)context.hits[k].v);
                distances[n] = (float)context.hits[k].distance;
            }
        }
        filled = 0;
    }
#endif
"""
"""Fills packets of sixteen rays and hands them to Embree's queries, called by their addresses. The layout is that of
``RTCRayHit16`` of embree4/rtcore_ray.h, of which ``RTCRay16`` is the beginning. ``coherent``: walk with a
whole packet. On CUDA nothing calls it.

Embree divides by approximations of its processor, which differ in the last bits. So it only says which triangles a ray meets; which
of them is nearest, and where (Moeller and Trumbore 1997), ``nearer`` finds in double precision, as every processor does. Of
triangles that coincide it is the first of the mesh."""


@wp.func_native(_PACKETS.replace("%BLOCK%", str(BLOCK)))
def _ask_embree(
    nearest: int, query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3),
    asked: wp.array(dtype=wp.uint8), coherent: int, item: int, vertices: wp.array(dtype=wp.vec3), corners: wp.array(dtype=int),
    faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2), distances: wp.array(dtype=float),
    blocked: wp.array(dtype=wp.uint8),
): ...  # fmt: skip


@wp.kernel(enable_backward=False)
def _trace_packets(
    first: int, nearest: int, query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3), asked: wp.array(dtype=wp.uint8), coherent: int, vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=int), faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=float), blocked: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """The ``nearest`` hits of rays, as many from every origin, or whether they hit anything; if there is ``asked``, of those."""
    _ask_embree(
        nearest, query, scene, origins, directions, asked, coherent, first + wp.tid(), vertices, corners, faces, barycentrics,
        distances, blocked,
    )  # fmt: skip


class EmbreeRays(RayCaster):
    """The tracer of the CPU: Embree 4, the library that ``embreex`` brings, asked for sixteen rays at a time.

    embreex itself asks for one after another, which takes 1.35 times as long for shadow rays (docs/log/performance.md). So its
    library is loaded here, the mesh is handed to it, and a Warp kernel calls its packet queries.
    """

    _kernel, _block = _trace_packets, BLOCK

    def __init__(self, mesh: Mesh) -> None:
        """Raises InputError where the embreex that is installed brings no Embree 4 that can be loaded."""
        super().__init__(mesh)
        library, device = _library()
        self._scene = library.rtcNewScene(device)
        weakref.finalize(self, library.rtcReleaseScene, self._scene)
        library.rtcSetSceneFlags(self._scene, FILTERED)
        geometry = library.rtcNewGeometry(device, TRIANGLES)
        faces, vertices = mesh.faces.astype(np.uint32), np.ascontiguousarray(mesh.vertices, np.float32)
        for values, kind, form in ((faces, INDICES, UINT3), (vertices, VERTICES, FLOAT3)):
            buffer = library.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(values))
            ctypes.memmove(buffer, np.ascontiguousarray(values).ctypes.data, 12 * len(values))
        self._triangles = torch.from_numpy(vertices.copy()), torch.from_numpy(faces.astype(np.int32).reshape(-1))
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(self._scene, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self._scene)
        any_hit, nearest = (ctypes.cast(query, c_void_p).value for query in (library.rtcOccluded16, library.rtcIntersect16))
        self._queries = any_hit, nearest


@cache
def _library() -> tuple[ctypes.CDLL, int]:
    """Embree 4, from where the wheels of embreex have it (beside the package, or inside it on macOS), and its one device.

    The device takes no ``threads``: workers of TBB that it limits and no longer needs would wait for work without sleeping.
    """
    import embreex

    package = Path(embreex.__file__).parent
    found = [*package.parent.glob("embreex.libs/*embree4*"), *package.glob(".dylibs/*embree4*")]
    if not found:
        raise InputError(f"{package}: expected the library embree4 that comes with the wheel of embreex 4, found none")
    library = ctypes.CDLL(str(found[0]))
    for name, result, *arguments in (
        ("rtcNewDevice", c_void_p, c_char_p),
        ("rtcNewScene", c_void_p, c_void_p),
        ("rtcNewGeometry", c_void_p, c_void_p, c_int),
        ("rtcSetNewGeometryBuffer", c_void_p, c_void_p, c_int, c_uint, c_int, c_size_t, c_size_t),
        ("rtcCommitGeometry", None, c_void_p),
        ("rtcAttachGeometry", c_uint, c_void_p, c_void_p),
        ("rtcReleaseGeometry", None, c_void_p),
        ("rtcCommitScene", None, c_void_p),
        ("rtcReleaseScene", None, c_void_p),
        ("rtcSetSceneFlags", None, c_void_p, c_int),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library, library.rtcNewDevice(None)


# ---------------- Warp ----------------


@wp.kernel(enable_backward=False)
def _trace_mesh(
    first: int, nearest: int, query: wp.uint64, mesh: wp.uint64, origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3), asked: wp.array(dtype=wp.uint8), coherent: int, vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=int), faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=float), blocked: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """As :func:`_trace_packets`, whose parameters it takes, but one ray an item."""
    i = first + wp.tid()
    each = directions.shape[0] // origins.shape[0]
    if asked.shape[0] > 0:
        if asked[i] == wp.uint8(0):
            return
    if nearest == 0:
        if wp.mesh_query_ray_anyhit(mesh, origins[i // each], directions[i], FAR):
            blocked[i] = wp.uint8(1)
        return
    hit = wp.mesh_query_ray(mesh, origins[i // each], directions[i], FAR)
    if hit.result:
        faces[i] = hit.face
        barycentrics[i] = wp.vec2(hit.v, 1.0 - hit.u - hit.v)  # Warp's u and v weigh corners 0 and 1
        distances[i] = hit.t


class WarpRays(RayCaster):
    """The tracer of CUDA devices."""

    _kernel = _trace_mesh

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        super().__init__(mesh)
        where = str(device)  # Warp knows "cuda", a device without a number; wp.device_from_torch does not
        points = wp.array(mesh.vertices, dtype=wp.vec3, device=where)
        self._mesh = wp.Mesh(points, wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=where))
        self._scene = self._mesh.id
