"""A procedural object under one procedural light, photographed from several sides by the renderer that fits it.

Objects, lights and materials are those of the priors' training images (:mod:`ia_bench_training`). The photographs are not: their
approximations would be what the refiner learns, and no fit of other photographs makes these errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.geometry.unwrapping import unwrap
from ia_bench.light.latlong import SampledLight, direction_to_texel, row_solid_angles
from ia_bench.material.brdf import tangent_frame
from ia_bench.material.textures import Material, fill_unobserved
from ia_bench.render.indirect import Atlas
from ia_bench.render.renderer import texture_images
from ia_bench.render.settings import REFERENCE_BOUNCES
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Mesh, Scene, View
from ia_bench_training.cameras import draw_camera
from ia_bench_training.lights import Light, draw_light
from ia_bench_training.objects import SolidObject, make_object
from ia_bench_training.palettes import palette
from ia_bench_training.render import MEAN_RADIANCE
from ia_bench_training.textures import TexturedMaterial, draw_material, draw_materials

MOST_FACES = 5000
"""An object with more triangles is drawn again, for baking it takes longer than the fit."""
LEAST_SLOTS, OVERLAYS = 3, 2
"""An object has at least so many materials, and over each at most so many others are laid. Training images have less of both: from
pixel to pixel their colours change by .03 in the median, and those of things that people model by .06 to .08."""
CROPPED = 0.1
"""In this share of the photographs the object is larger than the frame."""
PHOTOGRAPHS = (2, 3, 4, 4, 6, 8, 8, 8, 12, 16, 24, 40)
"""A scene has one of these numbers of photographs, each equally likely."""
NOISY, NOISE = 0.7, (0.005, 0.05)
"""This share of the scenes has sensor noise. Its standard deviation at the mean radiance, as a share of that, lies in this range,
and grows with the square root of the radiance."""
CLIPPED = 0.35
"""In this share of the scenes photographs are clipped and have 8 bits."""
SAME = 1e-4
"""Corners of triangles whose positions (in units of the object) and normals agree to so much become one vertex."""
TEXTURE, LIGHT_ROWS = 512, 128
"""True textures have so many texels along a side, and the true light so many rows."""
SIDE, SAMPLES = 3, 144
"""A pixel of the photographs has so many points along a side, and so many samples of the light in all."""
DISC = 4096
"""A disc of light becomes so many directions, spread evenly over it."""


@dataclass(frozen=True)
class ProceduralScene:
    """A scene and what it is made of.

    Attributes:
        scene: Photographs, masks, cameras and mesh, without truth.
        albedo: (V, S, S, 3), what the photographs show of the true albedo, premultiplied.
        roughness: (V, S, S, 1), of the true perceptual roughness likewise.
    """

    scene: Scene
    albedo: np.ndarray
    roughness: np.ndarray


@torch.no_grad()
def draw_scene(rng: Generator, size: int) -> ProceduralScene:
    """A scene of photographs of ``size`` pixels a side."""
    photographs = int(rng.choice(PHOTOGRAPHS))
    solid = make_object(rng)
    while len(solid.faces) > MOST_FACES or solid.slots < LEAST_SLOTS:
        solid = make_object(rng)
    light, materials = light_map(draw_light(rng), LIGHT_ROWS), [_rich(rng, each) for each in draw_materials(rng, solid.slots)]
    cameras = [draw_camera(rng, solid.vertices, size, cropped=CROPPED) for _ in range(photographs)]
    mesh, faces = _mesh(solid)
    stage = Stage(mesh, torch.device("cpu"))
    material = bake(solid, faces, mesh, materials)
    gbuffer = stage.gbuffer(cameras, SIDE)
    renderer = stage.renderer(bounces=REFERENCE_BOUNCES)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    radiance = renderer.render_images(gbuffer, material, SampledLight.of(light), SAMPLES, generator)["radiance"].numpy()
    albedo, roughness = (texture_images(stage.surface, gbuffer, each).numpy() for each in (material.albedo, material.roughness))
    masks = gbuffer.coverage().numpy()
    radiance *= np.exp(rng.normal(np.log(MEAN_RADIANCE), 0.25)) * masks.sum() / max(radiance.mean(-1).sum(), 1e-12)
    if rng.random() < NOISY:
        deviation = rng.uniform(*NOISE) * np.sqrt(radiance * radiance[masks > 0.5].mean()) * masks[..., None]
        radiance = (radiance + deviation * rng.normal(size=radiance.shape)).clip(0)
    views = tuple(
        View(f"{number:04d}", camera, image.astype(np.float32), mask.astype(np.float32))
        for number, (camera, image, mask) in enumerate(zip(cameras, radiance, masks, strict=True))
    )
    scene = Scene("procedural", "a procedural scene", mesh, views, metallic=False)
    if rng.random() < CLIPPED:
        scene = captured(scene, CaptureSettings(radiometry="ldr"), lambda _: None)
    return ProceduralScene(scene, albedo, roughness)


def _rich(rng: Generator, material: TexturedMaterial) -> TexturedMaterial:
    for _ in range(int(rng.integers(OVERLAYS + 1))):
        material = material.overlaid(draw_material(rng, palette(rng, 5)), rng)
    return material


def light_map(light: Light, rows: int) -> Tensor:
    """A light with its discs as one lat-long map (rows, 2 rows, 3) of the same irradiance."""
    times = rows // len(light.radiance)
    texels = light.radiance.repeat_interleave(times, 0).repeat_interleave(times, 1).clone()
    solid_angle = row_solid_angles(rows, 2 * rows).float()
    number = torch.arange(DISC) + 0.5
    turn = number * (math.pi * (3 - math.sqrt(5)))  # Vogel's spiral: equal areas
    for toward, edge, emission in zip(light.direction, light.cosine, light.emission, strict=True):
        if edge > 1:
            continue
        cosine = 1 - (number / DISC) * (1 - edge)
        sine = (1 - cosine.square()).clamp_min(0).sqrt()
        tangent, bitangent = tangent_frame(toward[None])
        directions = cosine[:, None] * toward + sine[:, None] * (turn.cos()[:, None] * tangent + turn.sin()[:, None] * bitangent)
        place = direction_to_texel(directions, rows, 2 * rows)
        share = 2 * math.pi * (1 - edge) / DISC / solid_angle[place // (2 * rows)]
        texels.view(-1, 3).index_add_(0, place, share[:, None] * emission)
    return texels


def bake(solid: SolidObject, faces: np.ndarray, mesh: Mesh, materials: list[TexturedMaterial]) -> Material:
    """The procedural ``materials`` as textures of the ``mesh``, whose triangles are ``faces`` (F,) of the object."""
    atlas = Atlas.of(mesh, TEXTURE, torch.device("cpu"))
    weight = torch.cat([1 - atlas.barycentric.sum(-1, keepdim=True), atlas.barycentric], -1)
    face = torch.from_numpy(faces)[atlas.face]
    local = torch.einsum("nw,nwc->nc", weight, torch.from_numpy(solid.local)[face].float())
    axis, slot = torch.from_numpy(solid.axis)[face], torch.from_numpy(solid.slot)[face]
    albedo, roughness, known = torch.zeros(TEXTURE**2, 3), torch.zeros(TEXTURE**2, 1), torch.zeros(TEXTURE**2, dtype=torch.bool)
    known[atlas.place] = True
    for number, material in enumerate(materials):
        mine = torch.nonzero(slot == number)[:, 0]
        if len(mine):
            albedo[atlas.place[mine]], roughness[atlas.place[mine]] = material(local[mine], axis[mine])
    square = (TEXTURE, TEXTURE)
    textures = [fill_unobserved(each.view(*square, -1), known.view(square)) for each in (albedo, roughness)]
    return Material(textures[0], textures[1])


def _mesh(solid: SolidObject) -> tuple[Mesh, np.ndarray]:
    """The object with shared vertices and a texture atlas, and which of its triangles (F',) are left: those that have an area."""
    vertices, normals = solid.vertices[solid.faces].reshape(-1, 3), solid.normals.reshape(-1, 3)
    key = np.round(np.concatenate([vertices, normals], 1) / SAME).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1, 3)
    corner = vertices[first][faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    left = np.nonzero(area > 1e-9)[0]
    return unwrap(vertices[first], faces[left], normals[first]), left
