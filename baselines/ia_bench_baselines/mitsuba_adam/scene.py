"""A scene of ours as Mitsuba 3 sees it: the same mesh, textures, light and cameras, lit by one environment map.

What differs: Mitsuba's ``principled`` BSDF couples its lobes and uses a separable Smith term, its environment map is
interpolated between texels, and its samples fall anywhere in a pixel. Mitsuba is an extra (``pip install mitsuba==3.9.1``)
and needs libLLVM, whose path goes into DRJIT_LIBLLVM_PATH where it is not found by itself.
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import math
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.scenes.scene import Camera, Mesh

TRIAL = """
import numpy, mitsuba
mitsuba.set_variant("llvm_ad_rgb")
numpy.array(mitsuba.render(mitsuba.load_dict(mitsuba.cornell_box()), spp=1))
"""
TEXTURES = {"albedo": "base_color", "roughness": "roughness"}


def import_mitsuba(threads: int | None = None) -> tuple[Any, Any]:
    """The modules ``mitsuba`` (variant llvm_ad_rgb) and ``drjit``, on ``threads`` threads.

    Raises InputError, saying why, where Mitsuba is not installed or cannot render.
    """
    reason = _missing()
    if reason is not None:
        raise InputError(f"Mitsuba 3 cannot be used: {reason}. It needs mitsuba==3.9.1 and libLLVM (DRJIT_LIBLLVM_PATH)")
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    if threads is not None:
        drjit.set_thread_count(threads)
    return mitsuba, drjit


@functools.cache
def _missing() -> str | None:
    """Why Mitsuba cannot be used, None if it can. Tried in a process of its own, which an unfit libLLVM may end."""
    if importlib.util.find_spec("mitsuba") is None:
        return "it is not installed"
    trial = subprocess.run([sys.executable, "-c", TRIAL], capture_output=True, text=True)
    if trial.returncode == 0:
        return None
    return (trial.stderr.strip().splitlines() or [f"a trial ended with {trial.returncode}"])[-1]


class MitsubaScene:
    """One object under one light, seen by some cameras.

    ``camera_rays`` of a render is what Mitsuba calls spp; each takes ``samples_per_ray`` light and BSDF samples, half of each.
    """

    samples_per_ray = 2

    def __init__(
        self,
        mesh: Mesh,
        cameras: Sequence[Camera],
        material: Material,
        light: Tensor,
        *,
        depth: int = 2,
        threads: int | None = None,
    ) -> None:
        """``material`` and ``light`` (H, W, 3) as our renderer takes them; ``depth``: of the longest path, 2 is direct light.

        Raises InputError where Mitsuba is missing.
        """
        self.mi, self.dr = import_mitsuba(threads)
        mi = self.mi
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": self.integrator(depth),
                "light": {
                    "type": "envmap",
                    "bitmap": mi.Bitmap(np.ascontiguousarray(light.detach().numpy(), np.float32)),
                    # Mitsuba's map has its pole on +y and its middle column toward -z; ours +z and -x ... +x
                    "to_world": mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])),
                },
                "object": self._shape(mesh, material),
            }
        )
        self.sensors = [mi.load_dict(self._sensor(camera)) for camera in cameras]
        self.parameters = mi.traverse(self.scene)
        found = [name for name, _ in self.parameters]
        self.names = {ours: next(n for n in found if n.endswith(f"{its}.data")) for ours, its in TEXTURES.items()}
        self.names["light"] = next(n for n in found if n == "light.data")

    def integrator(self, depth: int) -> dict[str, Any]:
        """What Mitsuba follows paths with: detached sampling, as ours."""
        return {"type": "prb", "hide_emitters": True, "max_depth": depth}

    def render(self, camera: int, camera_rays: int, seed: int) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        """The (H, W, 3) image of one camera, lazily evaluated, differentiable in the scene's ``parameters``."""
        return self.mi.render(self.scene, self.parameters, sensor=self.sensors[camera], spp=camera_rays, seed=seed)

    def image(self, camera: int, camera_rays: int, seed: int) -> np.ndarray:
        """The evaluated image of one camera, (H, W, 3) float32."""
        image = np.array(self.render(camera, camera_rays, seed))
        self.dr.sync_thread()
        return image

    def albedo(self, camera: int) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        """Premultiplied albedo (H, W, 3) of one camera, the mean of 2 x 2 points of a pixel; differentiable in the texture."""
        mi, dr = self.mi, self.dr
        sensor = self.sensors[camera]
        width, height = sensor.film().size()
        index = dr.arange(mi.UInt32, width * height)
        total = mi.Color3f(0)
        for down, across in itertools.product((0.25, 0.75), repeat=2):
            position = mi.Point2f((index % width + across) / width, (index // width + down) / height)
            ray, _ = sensor.sample_ray(0.0, 0.5, position, mi.Point2f(0.5))
            hit = self.scene.ray_intersect(ray)
            total += hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid()) / 4
        return mi.TensorXf(dr.ravel(total), (height, width, 3))

    def _shape(self, mesh: Mesh, material: Material) -> Any:  # noqa: ANN401 (mi.Mesh)
        mi = self.mi

        def texture(values: Tensor) -> dict[str, Any]:
            return {"type": "bitmap", "raw": True, "wrap_mode": "clamp", "bitmap": mi.Bitmap(values.detach().cpu().numpy())}

        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(
            {
                "type": "principled",
                "base_color": texture(material.albedo),
                "roughness": texture(material.roughness),
                "specular": 0.5,  # F0 = 0.04
            }
        )
        shape = mi.Mesh(
            "object",
            len(mesh.vertices),
            len(mesh.faces),
            has_vertex_normals=True,
            has_vertex_texcoords=True,
            props=properties,
        )
        buffers = mi.traverse(shape)
        buffers["vertex_positions"], buffers["faces"] = mesh.vertices.ravel(), mesh.faces.astype(np.uint32).ravel()
        buffers["vertex_normals"] = mesh.normals.ravel()
        buffers["vertex_texcoords"] = np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], -1).ravel()  # its row 0 is v = 0
        buffers.update()
        return shape

    def _sensor(self, camera: Camera) -> dict[str, Any]:
        """Mitsuba's cameras look along +z with +x to the left, and their pixels are square. Raises InputError for others."""
        mi = self.mi
        across, down = camera.focal
        if not math.isclose(across, down, rel_tol=1e-3):
            raise InputError(f"method=mitsuba_adam: expected square pixels, found focal lengths of {across:g} and {down:g} pixels")
        return {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(camera.width / 2 / across)),
            "principal_point_offset_x": 0.5 - camera.centre[0] / camera.width,
            "principal_point_offset_y": 0.5 - camera.centre[1] / camera.height,
            "to_world": mi.ScalarTransform4f(camera.to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
            "sampler": {"type": "independent"},
        }
