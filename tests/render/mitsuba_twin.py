"""One scene for two renderers: ours and Mitsuba 3, with the same mesh, textures, light and camera rays.

What Mitsuba brings of its own: rays, camera, texture lookup, shading frames, light sampling and its MIS, the GGX
distribution and Smith's G1, the `diffuse` BSDF, path replay (`prb`) for the gradients. What is written here: the sum of
equation 2 from these parts, and the light and its axes in the words of scene.json. Both look through the centres of the pixels.
"""

import math
import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from shapes import camera_at
from stage import Stage

from ia_bench.common.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.scenes.scene import Camera, Mesh
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba

FINE = 16  # Mitsuba interpolates between texels: each of ours is this many of its own along a side, so that it hardly does


@dataclass(frozen=True)
class Twin:
    """``albedo`` (T, T, 3), ``roughness`` (T, T, 1) and ``light`` (H, W, 3) are float32 arrays."""

    mesh: Mesh
    camera: Camera
    albedo: np.ndarray
    roughness: np.ndarray
    light: np.ndarray

    @cached_property
    def stage(self) -> Stage:
        return Stage(self.mesh, [self.camera])

    @property
    def material(self) -> Material:
        return Material(torch.from_numpy(self.albedo), torch.from_numpy(self.roughness))


def twin_scene() -> Twin:
    """A ball in a ring, which shadow each other, under random textures and a random light, in a picture that is not square."""
    rng = np.random.default_rng(1)
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.apply_scale([1.0, 1.0, 0.7])
    solid = trimesh.util.concatenate([ball, trimesh.creation.torus(1.25, 0.25, major_sections=160, minor_sections=80)])
    vertices = solid.vertices.astype(np.float32)
    mesh = Mesh(
        vertices,
        solid.faces.astype(np.int32),
        solid.vertex_normals.astype(np.float32),
        np.column_stack([0.5 + 0.3 * vertices[:, 0], 0.5 + 0.3 * vertices[:, 1]]).astype(np.float32),
    )
    camera = camera_at((2.0, -3.0, 3.5), pixels=26, field_of_view=38.0)
    return Twin(
        mesh,
        replace(camera, width=30, centre=(15.0, 13.0)),
        (0.1 + 0.8 * rng.random((5, 5, 3))).astype(np.float32),
        (0.35 + 0.6 * rng.random((5, 5, 1))).astype(np.float32),
        (rng.random((6, 12, 3)) ** 3).astype(np.float32),
    )


# ---------------------------------------------------------------- Mitsuba's side
def load_mitsuba() -> Any:
    """Mitsuba in the variant `llvm_ad_rgb`, with what it lacks; skips the test, with the reason, where it cannot be had."""
    try:
        mi, _ = import_mitsuba()
    except InputError as error:
        pytest.skip(str(error))
    register(mi)
    return mi


def light_nodes(height: int, width: int) -> np.ndarray:
    """Flat texels of ours just above and just below each node of Mitsuba's light, (2, FINE height + 1, FINE width) int64.

    The two differ where a node lies on the edge of a row; it is given their mean.

    Mitsuba's `envmap`: row r of R at theta = pi r / (R - 1) from its pole, column c of C at phi = 2 pi (c + 0.5) / C, toward
    (sin theta sin phi, cos theta, -sin theta cos phi) before `to_world`, which turns +y to +z and -z to +y here. Ours, in the
    words of scene.json: theta = pi (r + 0.5) / H from +z, phi = pi - 2 pi (c + 0.5) / W from +x toward +y.
    """
    rows, columns = FINE * height + 1, FINE * width
    theta = np.pi * (np.arange(rows) + np.array([[-0.25], [0.25]])) / (rows - 1)
    phi = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    azimuth = np.arctan2(np.cos(phi), np.sin(phi))  # of (x, y) = (sin phi, cos phi), from +x toward +y
    row = np.clip(np.floor(theta / np.pi * height).astype(int), 0, height - 1)
    column = np.clip(np.floor((np.pi - azimuth) / (2 * np.pi) * width).astype(int), 0, width - 1)
    return row[..., None] * width + column


def register(mi: Any) -> None:
    """The sensor and the BSDF that Mitsuba does not have."""
    import drjit as dr

    class PixelCentres(mi.Sensor):
        """Mitsuba's own camera, asked for the centre of each pixel only."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.camera = props["camera"]
            self.size = mi.Vector2f(self.film().size())

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            centre = (dr.floor(sample2 * self.size) + 0.5) / self.size
            return self.camera.sample_ray(time, sample1, centre, sample3, active)

        def sample_ray_differential(self, *arguments: Any, **named: Any) -> Any:
            ray, weight = self.sample_ray(*arguments, **named)
            return mi.RayDifferential3f(ray), weight

    class Equation2(mi.BSDF):
        """albedo / pi + D G2 F / (4 cos cos): Mitsuba's GGX and G1, joined to the height-correlated G2 (Heitz 2014, eq. 99)."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.albedo, self.roughness = props["albedo"], props["roughness"]
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def distribution(self, si: Any, active: Any) -> Any:
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.roughness.eval_1(si, active) ** 2, True)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            half = dr.normalize(si.wi + wo)
            ggx = self.distribution(si, active)
            g_i, g_o = ggx.smith_g1(si.wi, half), ggx.smith_g1(wo, half)
            g2 = g_i * g_o / (g_i + g_o - g_i * g_o)
            fresnel = dr.lerp((1 - dr.dot(si.wi, half)) ** 5, 1.0, 0.04)
            specular = ggx.eval(half) * g2 * fresnel / (4 * cos_i)
            value = self.albedo.eval(si, active) * (cos_o / dr.pi) + specular
            return dr.select(active & (cos_i > 0) & (cos_o > 0), value, 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            half = dr.normalize(si.wi + wo)
            lobe = self.distribution(si, active).pdf(si.wi, half) / (4 * dr.dot(wo, half))
            density = 0.5 * (lobe + cos_o / dr.pi)
            return dr.select(active & (cos_i > 0) & (cos_o > 0), density, 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            micro, _ = self.distribution(si, active).sample(si.wi, sample2)
            mirrored = 2 * dr.dot(si.wi, micro) * micro - si.wi
            found = dr.zeros(mi.BSDFSample3f)
            found.wo = dr.select(sample1 < 0.5, mirrored, mi.warp.square_to_cosine_hemisphere(sample2))
            found.pdf = self.pdf(ctx, si, found.wo, active)
            found.eta, found.sampled_type, found.sampled_component = 1.0, +self.m_flags, 0
            valid = active & (found.pdf > 0)
            return found, dr.select(valid, self.eval(ctx, si, found.wo, valid) / found.pdf, 0)

        def traverse(self, callback: Any) -> None:
            callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)
            callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return "Equation2[]"

    mi.register_sensor("pixel_centres", PixelCentres)
    mi.register_bsdf("equation2", Equation2)


class MitsubaTwin:
    """A Twin in Mitsuba. ``bsdf`` is "diffuse" (Mitsuba's) or "equation2"; ``max_depth`` 2 is direct light alone."""

    def __init__(self, mi: Any, twin: Twin, *, bsdf: str, max_depth: int) -> None:
        self._mi, self._twin = mi, twin
        self._nodes = light_nodes(*twin.light.shape[:2])
        self._keys = {"albedo": "object.bsdf.reflectance.data", "light": "light.data"}

        def texture(values: np.ndarray) -> dict[str, Any]:
            bitmap = mi.Bitmap(np.ascontiguousarray(values))
            return {"type": "bitmap", "raw": True, "bitmap": bitmap, "wrap_mode": "clamp", "format": "variant"}

        material: dict[str, Any] = {"type": "diffuse", "reflectance": texture(twin.albedo)}
        if bsdf == "equation2":
            self._keys |= {"albedo": "object.bsdf.albedo.data", "roughness": "object.bsdf.roughness.data"}
            material = {"type": bsdf, "albedo": texture(twin.albedo), "roughness": texture(twin.roughness)}
        scene = {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": max_depth, "rr_depth": 100, "hide_emitters": True},
            "sensor": {"type": "pixel_centres", "camera": self._camera(), **self._film()},
            "light": {
                "type": "envmap",
                "bitmap": mi.Bitmap(twin.light.reshape(-1, 3)[self._nodes].mean(0)),
                "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
            },
        }
        with tempfile.TemporaryDirectory() as folder:
            scene["object"] = {"type": "ply", "filename": self._mesh(Path(folder)), "bsdf": material}
            self.scene = mi.load_dict(scene)
        self.parameters = mi.traverse(self.scene)

    def _film(self) -> dict[str, Any]:
        size = {"width": self._twin.camera.width, "height": self._twin.camera.height}
        film = {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32", **size}
        return {"film": film, "sampler": {"type": "independent"}}

    def _camera(self) -> dict[str, Any]:
        camera = self._twin.camera
        opengl_to_mitsuba = np.diag([-1.0, 1.0, -1.0, 1.0])  # Mitsuba's cameras look along +z, with +x to the left
        return {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(camera.width / 2 / camera.focal[0])),
            "to_world": self._mi.ScalarTransform4f(camera.to_world @ opengl_to_mitsuba),
            **self._film(),
        }

    def _mesh(self, folder: Path) -> str:
        mesh = self._twin.mesh
        shape = self._mi.Mesh("o", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True, has_vertex_texcoords=True)
        buffers = self._mi.traverse(shape)
        buffers["vertex_positions"], buffers["faces"] = mesh.vertices.ravel(), mesh.faces.astype(np.uint32).ravel()
        buffers["vertex_normals"] = mesh.normals.ravel()
        buffers["vertex_texcoords"] = (mesh.uv * (1, -1) + (0, 1)).astype(np.float32).ravel()  # row 0 of its bitmaps is v = 0
        buffers.update()
        path = folder / "object.ply"
        shape.write_ply(str(path))
        return str(path)

    def image(self, samples: int, seed: int) -> np.ndarray:
        """Radiance (H, W, 3) from ``samples`` paths a pixel."""
        return np.array(self._mi.render(self.scene, spp=samples, seed=seed))

    def gradients(self, proxy: np.ndarray, samples: int, seed: int) -> dict[str, np.ndarray]:
        """Gradients of sum(proxy * image), ``proxy`` (H, W, 3), in every texel of what there is of albedo, roughness, light."""
        import drjit as dr

        leaves = {name: dr.detach(self.parameters[key]) for name, key in self._keys.items()}
        dr.enable_grad(list(leaves.values()))
        for name, leaf in leaves.items():
            self.parameters[self._keys[name]] = leaf
        self.parameters.update()
        image = self._mi.render(self.scene, self.parameters, spp=samples, seed=seed)
        dr.backward(dr.sum(image * self._mi.TensorXf(proxy), axis=None))
        found = {name: np.array(dr.grad(leaf)) for name, leaf in leaves.items()}
        nodes = np.pad(self._nodes, ((0, 0), (0, 0), (1, 1)), mode="wrap")  # as Mitsuba pads it
        light = np.broadcast_to(found["light"] / 2, (2, *found["light"].shape))
        found["light"] = np.stack([np.bincount(nodes.ravel(), light[..., c].ravel()) for c in range(3)], -1)
        return found
