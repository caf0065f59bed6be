"""Warp kernels that fill packets of sixteen rays and hand them to Embree's queries, called by their addresses; CPU only.

The layout is that of ``RTCRayHit16`` of embree4/rtcore_ray.h, of which ``RTCRay16`` is the beginning.
"""

import warp as wp

BLOCK = 128  # rays of a kernel's item: those of them that are asked for fill its packets

_ASK = """
    const int W = 16;
    const int BLOCK = BLOCK_SIZE;
    struct alignas(64) Packet {
        float ox[W], oy[W], oz[W], near[W], dx[W], dy[W], dz[W], time[W], far[W];
        unsigned mask[W], id[W], flags[W];
        float nx[W], ny[W], nz[W], u[W], v[W];
        unsigned primitive[W], geometry[W], instance[2][W];
    };
    struct Arguments { unsigned flags, features; void *context, *filter, *function; };  // RTCIntersectArguments
    typedef void (*Query)(const int*, void*, void*, Arguments*);
    Arguments arguments = {coherent ? 1u << 16 : 0u, 0xffffffffu, nullptr, nullptr, nullptr};
    Packet packet;
    alignas(64) int valid[W];
    int which[W];
    int filled = 0;
    int end = (item + 1) * BLOCK < count ? (item + 1) * BLOCK : count;
    for (int i = item * BLOCK; i < end; ++i) {
        if (!masked || asked[i]) {
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
            packet.mask[k] = packet.geometry[k] = packet.instance[0][k] = packet.instance[1][k] = packet.primitive[k] = 0xffffffffu;
            packet.id[k] = packet.flags[k] = 0u;
            valid[k] = k < filled ? -1 : 0;
        }
        ((Query)query)(valid, (void*)scene, &packet, &arguments);
        for (int k = 0; k < filled; ++k) {
            const int n = which[k];
            (void)n;
            RESULT
        }
        filled = 0;
    }
"""
_OCCLUDED = "blocked[n] = packet.far[k] < 0.0f ? 1 : 0;"
_INTERSECTED = """
            if (packet.geometry[k] != 0xffffffffu) {
                faces[n] = packet.primitive[k];
                barycentrics[n] = wp::vec2(packet.u[k], packet.v[k]);
                distances[n] = packet.far[k];
            }
"""


def _snippet(result: str) -> str:
    return _ASK.replace("BLOCK_SIZE", str(BLOCK)).replace("RESULT", result)


@wp.func_native(_snippet(_OCCLUDED))
def _ask_occluded(
    query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3),
    each: int, masked: int, asked: wp.array(dtype=wp.uint8), coherent: int, count: int, item: int,
    blocked: wp.array(dtype=wp.uint8),
): ...  # fmt: skip


@wp.func_native(_snippet(_INTERSECTED))
def _ask_nearest(
    query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3),
    each: int, masked: int, asked: wp.array(dtype=wp.uint8), coherent: int, count: int, item: int,
    faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=float),
): ...  # fmt: skip


@wp.kernel(enable_backward=False)
def occluded(
    first: int, query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3),
    each: int, masked: int, asked: wp.array(dtype=wp.uint8), coherent: int, count: int, blocked: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Whether ``count`` rays, ``each`` from every origin, hit anything; if ``masked`` only those that are ``asked`` for.

    ``coherent``: whether rays that follow each other take nearly the same way; Embree then walks with a whole packet at once.
    """
    _ask_occluded(query, scene, origins, directions, each, masked, asked, coherent, count, first + wp.tid(), blocked)


@wp.kernel(enable_backward=False)
def nearest(
    first: int, query: wp.uint64, scene: wp.uint64, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3),
    each: int, masked: int, asked: wp.array(dtype=wp.uint8), coherent: int, count: int,
    faces: wp.array(dtype=int), barycentrics: wp.array(dtype=wp.vec2),
    distances: wp.array(dtype=float),
):  # fmt: skip
    """Their nearest hits, where there are any."""
    item = first + wp.tid()
    _ask_nearest(query, scene, origins, directions, each, masked, asked, coherent, count, item, faces, barycentrics, distances)
