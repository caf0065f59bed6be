"""One mesh, and what it takes to render it: made when it is first asked for, and then kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import groupby

import torch

from ia_bench.common.machine import expect_memory
from ia_bench.render.gbuffer import RAYS_AT_ONCE, GBuffer, SurfaceInterpolator, trace_gbuffer
from ia_bench.render.indirect import ATLAS_SIZE, bake_interreflection
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.render.renderer import Renderer
from ia_bench.scenes.scene import Camera, Mesh

POINT_BYTES, RAY_BYTES = 12, 200  # of a point in a G-buffer, of a primary ray while it is traced
KEPT_BYTES = 512 * 2**20  # of G-buffers; what is more is traced again whenever it is asked for
BATCH_POINTS = 8 * 2**20  # G-buffer points that are looked at together where memory must stay bounded: 128 MB of them


class Stage:
    """A mesh on a device, with its surface, rays, G-buffers and renderers. Nothing is built before it is asked for.

    Attributes:
        mesh: The triangles that everything below belongs to.
        device: Where tensors live and rays are traced.
    """

    def __init__(self, mesh: Mesh, device: torch.device) -> None:
        self.mesh, self.device = mesh, device
        self._gbuffers: dict[bytes, GBuffer] = {}
        self._renderers: dict[tuple[str, int, str, int, bool], Renderer] = {}

    @cached_property
    def surface(self) -> SurfaceInterpolator:
        """``stage.surface(face, barycentric, centre)`` gives points of (N,), (N, 2), (N, 3); see :class:`SurfaceInterpolator`."""
        return SurfaceInterpolator(self.mesh, self.device)

    @cached_property
    def rays(self) -> RayCaster:
        """The exact ray tracer of the device."""
        return make_rays(self.mesh, self.device)

    @cached_property
    def apart(self) -> Stage:
        """Another stage of the same mesh, for scores and pictures: its rays and points are not counted with those of a fit."""
        return Stage(self.mesh, self.device)

    def counts(self) -> dict[str, int]:
        """What was asked of the mesh so far: rays, points, and normals that had to be bent toward the camera."""
        rays: RayCaster | None = vars(self).get("rays")
        surface: SurfaceInterpolator | None = vars(self).get("surface")
        points, bent = (0, 0) if surface is None else (surface.points, surface.bent_normals)
        return {"rays": 0 if rays is None else rays.rays, "points": points, "bent_normals": bent}

    def gbuffer(self, cameras: Sequence[Camera], side: int) -> GBuffer:
        """What ``cameras``, all of one size, see with ``side`` x ``side`` points a pixel; kept while there is room."""
        key = b"".join([side.to_bytes(4, "little"), *map(camera_key, cameras)])
        if key in self._gbuffers:
            return self._gbuffers[key]
        points = side**2 * sum(camera.width * camera.height for camera in cameras)
        expect_memory(f"{side} x {side} points a pixel", points * POINT_BYTES + RAYS_AT_ONCE * RAY_BYTES, self.device.type)
        gbuffer = trace_gbuffer(list(cameras), self.rays, side, self.device)
        if sum(kept.size_bytes for kept in self._gbuffers.values()) + gbuffer.size_bytes <= KEPT_BYTES:
            self._gbuffers[key] = gbuffer
        return gbuffer

    def gbuffers(self, cameras: Sequence[Camera], side: int) -> Iterator[GBuffer]:
        """The same in batches of neighbouring cameras of one size, for any number of views of any size."""
        for (height, width), group in groupby(cameras, lambda camera: (camera.height, camera.width)):
            alike, most = list(group), max(1, BATCH_POINTS // (height * width * side**2))
            for first in range(0, len(alike), most):
                yield self.gbuffer(alike[first : first + most], side)

    def renderer(
        self,
        *,
        shadows: str = "traced",
        bounces: int = 0,
        coat: str = "layered",
        atlas_size: int = ATLAS_SIZE,
        control_variate: bool = False,
    ) -> Renderer:
        """The renderer of these settings (see :class:`ia_bench.render.settings.RenderSettings`); bakes are kept in the cache.

        ``atlas_size``: texels along a side of the atlas between whose texels light is exchanged.
        Raises InputError where the mesh has no texture coordinates that indirect light could use.
        """
        key = (shadows, bounces, coat, atlas_size, control_variate)
        if key not in self._renderers:
            baked = self.surface, self.rays, bounces
            indirect = bake_interreflection(*baked, atlas_size=atlas_size, controlled=control_variate) if bounces else None
            rays = None if shadows == "none" else self.rays
            self._renderers[key] = Renderer(self.surface, rays, interreflection=indirect, coat=coat)
        return self._renderers[key]


def camera_key(camera: Camera) -> bytes:
    """What tells cameras apart that see different things."""
    return camera.to_world.tobytes() + repr((camera.focal, camera.centre, camera.width, camera.height)).encode()
