"""Rays on the CPU by Embree 4, the library that ``embreex`` brings, asked for sixteen rays at a time.

embreex itself asks for one after another, which takes 1.35 times as long for shadow rays (benchmarks/rays.py). So its library is
loaded here, the mesh is handed to it, and Warp kernels call its packet queries by their addresses.
"""

from __future__ import annotations

import ctypes
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_uint, c_void_p
from functools import cache
from pathlib import Path

import numpy as np
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.warp_launch import launch
from ia_bench.render import embree_packets
from ia_bench.render.embree_packets import BLOCK
from ia_bench.render.ray_caster import RayCaster
from ia_bench.scenes.scene import Mesh

TRIANGLES, INDICES, VERTICES, UINT3, FLOAT3 = 0, 0, 1, 0x5003, 0x9003  # Embree's enumerations


class EmbreeRays(RayCaster):
    """The tracer of the CPU."""

    def __init__(self, mesh: Mesh) -> None:
        """Raises InputError where the embreex that is installed brings no Embree 4 that can be loaded."""
        super().__init__(mesh)
        library, device = _library()
        self._scene = library.rtcNewScene(device)
        weakref.finalize(self, library.rtcReleaseScene, self._scene)
        geometry = library.rtcNewGeometry(device, TRIANGLES)
        faces, vertices = mesh.faces.astype(np.uint32), np.ascontiguousarray(mesh.vertices, np.float32)
        for values, kind, form in ((faces, INDICES, UINT3), (vertices, VERTICES, FLOAT3)):
            buffer = library.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(values))
            ctypes.memmove(buffer, np.ascontiguousarray(values).ctypes.data, 12 * len(values))
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(self._scene, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self._scene)
        self._occluded, self._nearest = (
            ctypes.cast(getattr(library, name), c_void_p).value for name in ("rtcOccluded16", "rtcIntersect16")
        )

    def _trace(
        self, nearest: bool, origins: Tensor, directions: Tensor, asked: Tensor | None, coherent: bool, *results: Tensor
    ) -> None:
        count = len(directions)
        kernel, query = (embree_packets.nearest, self._nearest) if nearest else (embree_packets.occluded, self._occluded)
        launch(
            kernel, -(-count // BLOCK), query, self._scene, origins, directions,
            count // len(origins), int(asked is not None), asked, int(coherent), count, *results, device=origins.device,
        )  # fmt: skip


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
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library, library.rtcNewDevice(None)
