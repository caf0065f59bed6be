"""What the writers of datasets share: lights as formulas, photographs of a mirror ball, and pictures as programs store them.

A writer makes a folder in another format from a scene of ours, from the description of that format alone: no code of the
readers is used. What it writes is quantised as that format is; the bounds of :func:`expect_same` follow from the quantisation.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image

from ia_bench.scenes.scene import Camera, Scene, View

Light = Callable[[np.ndarray], np.ndarray]
STEP = 0.5 / 255  # half of a step of 8 bits
STEEPEST = 2.28  # slope of the sRGB decoding, at 1
TINTS = {"city": (1.0, 0.8, 0.5), "night": (0.3, 0.4, 0.9)}
TRAIN_LIGHT = "sunset"


def lobes(*parts: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Light:
    """A light of smooth lobes: an axis and a colour each, on a dim grey; no two directions of an axis look alike."""

    def radiance(directions: np.ndarray) -> np.ndarray:
        total = np.full(directions.shape, 0.05)
        for axis, colour in parts:
            unit = np.array(axis) / np.linalg.norm(axis)
            total = total + np.exp(6 * (directions @ unit - 1))[..., None] * np.array(colour)
        return total

    return radiance


LIGHTS: dict[str, Light] = {
    "sunset": lobes(((1, 0, 0), (0.8, 0, 0)), ((0, 1, 0), (0, 0.8, 0)), ((0, 0, 1), (0, 0, 0.8))),
    "city": lobes(((0, -1, 0.3), (0.7, 0.5, 0)), ((-1, 0.2, 0), (0, 0.6, 0.6)), ((0, 0.2, -1), (0.5, 0, 0.5))),
    "night": lobes(((1, 1, 1), (0.9, 0.2, 0.1)), ((-1, 0, 0.5), (0.1, 0.7, 0.1))),
}


def rays(camera: Camera) -> np.ndarray:
    """Unit directions (H, W, 3) through the centres of a camera's pixels."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y = (column - camera.centre[0]) / camera.focal[0], -(row - camera.centre[1]) / camera.focal[1]
    ahead = np.stack([x, y, -np.ones_like(x)], -1) @ camera.to_world[:3, :3].T
    return ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)


def reflected(camera: Camera, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel's ray goes from a mirror ball at the origin, (H, W, 3), and which rays meet the ball, (H, W)."""
    ahead, place = rays(camera), camera.to_world[:3, 3]
    middle = -(ahead @ place)
    depth = middle**2 - (place @ place - radius**2)
    hit = depth > 0
    point = place + (middle - np.sqrt(np.maximum(depth, 0)))[..., None] * ahead
    normal = point / radius
    return ahead - 2 * (ahead * normal).sum(-1, keepdims=True) * normal, hit


def ball_seen(view: View, light: str, radius: float = 0.6) -> View:
    """The view of a mirror ball that reflects a light of :data:`LIGHTS`."""
    directions, hit = reflected(view.camera, radius)
    image = (LIGHTS[light](directions) * hit[..., None]).astype(np.float32)
    return View(view.name, view.camera, image, hit.astype(np.float32), view.light)


# ---------------------------------------------------------------- pictures and files
def to_srgb(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, clipped to what 8 bits hold."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def straight(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Colours without the coverage that they were multiplied by, 0 where there is none."""
    share = mask if image.ndim == 2 else mask[..., None]
    return np.where(share > 0, image / np.maximum(share, 1e-9), 0)


def save_png(path: Path, colour: np.ndarray, alpha: np.ndarray | None = None) -> None:
    """8 bits of values from 0 to 1: (H, W) or (H, W, 3), with alpha (H, W) or without."""
    path.parent.mkdir(parents=True, exist_ok=True)
    layers = colour if alpha is None else np.concatenate([colour, alpha[..., None]], -1)
    Image.fromarray(np.round(np.clip(layers, 0, 1) * 255).astype(np.uint8)).save(path)


def save_photo(path: Path, view: View) -> None:
    """A photograph as Blender saves it: sRGB, straight alpha."""
    save_png(path, to_srgb(straight(view.image, view.mask)), view.mask)


def save_exr(path: Path, image: np.ndarray) -> None:
    """A linear picture (H, W, 3) in half floats."""
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = {name: np.ascontiguousarray(image[..., c].astype(np.float16)) for c, name in enumerate("RGB")}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))


def save_hdr(path: Path, radiance: np.ndarray) -> None:
    """A Radiance picture, rows encoded as runs of at most two and of single bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = radiance.shape[:2]
    _, exponent = np.frexp(radiance.max(-1))
    mantissa = np.floor(radiance * np.exp2(8.0 - exponent)[..., None]).clip(0, 255)
    pixels = np.concatenate([mantissa, (exponent + 128)[..., None]], -1).astype(np.uint8)
    content = bytearray(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {height} +X {width}\n".encode())
    for row in pixels:
        content += bytes([2, 2, width >> 8, width & 255])
        for channel in range(4):
            values = row[:, channel].tolist()
            while values:
                if len(values) > 1 and values[0] == values[1]:
                    content += bytes([130, values[0]])
                    values = values[2:]
                else:
                    content += bytes([1, values[0]])
                    values = values[1:]
    path.write_bytes(bytes(content))


def blender_map(light: Light, height: int = 16) -> np.ndarray:
    """A light as Blender's world texture: u = 1/2 - azimuth / (2 pi) from the left, v = the angle from +z / pi from the top."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    azimuth, polar = (0.5 - u) * 2 * np.pi, v * np.pi
    return light(np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1))


def save_json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def angle_x(camera: Camera) -> float:
    """What a camera sees across, in radians."""
    return 2 * float(np.arctan(0.5 * camera.width / camera.focal[0]))


# ---------------------------------------------------------------- what is to be read back
def tinted(view: View, light: str) -> View:
    """A stand-in for the view under a novel light: the same photograph in other colours."""
    return replace(view, image=(view.image * np.array(TINTS[light])).astype(np.float32), light=light)


def under_novel_lights(views: tuple[View, ...]) -> tuple[View, ...]:
    return tuple(v for view in views for v in (view, *(tinted(view, light) for light in TINTS)))


def as_written(scene: Scene) -> Scene:
    """Everything that was to be written is read back."""
    return scene


def unlit(scene: Scene) -> Scene:
    """Held-out photographs under the training light alone."""
    return replace(scene, novel=scene.test)


def three_held_out(scene: Scene) -> Scene:
    """Photographs 0, 8 and 16 of nineteen are held out."""
    return replace(scene, test=scene.test[:3], novel=scene.test[:3])


@dataclass(frozen=True)
class Layout:
    """A format, and what a scene is once it went through it.

    Attributes:
        name: Of the reader.
        write: Writes a scene into a folder. Its novel cameras are those of its test views.
        expected: The part of the scene that the format holds.
        known: Which truth of test views it holds.
        lights: Whether it has maps of lights.
        options: Of the reader, for a folder.
        linear: Which splits are not 8-bit sRGB.
        binary: Whether a pixel is either covered or not.
        steps: How many steps of 8 bits a value may be off, for lossy files.
        white: The radiance at which 8 bits end.
        own_mesh: Whether the writer writes a mesh.
        root: The folder below the written one that scene.path names.
        stands_for: The light of LIGHTS that the format's name of a novel light means.
    """

    name: str
    write: Callable[[Path, Scene], None]
    expected: Callable[[Scene], Scene] = as_written
    known: tuple[str, ...] = ()
    lights: bool = False
    options: Callable[[Path], Mapping[str, Any]] = lambda folder: {}
    linear: tuple[str, ...] = ()
    binary: bool = False
    steps: float = 1.0
    white: float = 1.0
    own_mesh: bool = False
    root: str = ""
    stands_for: Callable[[str], str] = lambda name: name

    def formula(self, name: str) -> Light:
        """The light that the format calls ``name``."""
        return LIGHTS[TRAIN_LIGHT if name == "train" else self.stands_for(name)]

    @property
    def id(self) -> str:
        """The writer's name: a reader may read more than one layout."""
        return self.write.__name__.removeprefix("write_")


def scene_to_write(tiny: Scene) -> Scene:
    """The shipped scene with test views that are also there under novel lights, as most datasets have them."""
    return replace(tiny, novel=under_novel_lights(tiny.test))


def expect_camera(found: Camera, expected: Camera, exact: float = 1e-6) -> None:
    np.testing.assert_allclose(found.to_world, expected.to_world, atol=exact)
    np.testing.assert_allclose([*found.focal, *found.centre], [*expected.focal, *expected.centre], rtol=exact)
    assert (found.width, found.height) == (expected.width, expected.height)


def expect_photo(found: View, expected: View, layout: Layout, split: str) -> None:
    """Pixels as far as their quantisation tells: 8 bits of sRGB and of alpha, or half floats with 8 bits of a mask."""
    linear, step = split in layout.linear, layout.steps * STEP
    mask = np.where(expected.mask > 0.5, 1.0, 0.0) if layout.binary else expected.mask
    assert np.abs(found.mask - mask).max() <= STEP + 1e-6
    colour = straight(expected.image, expected.mask)
    colour = colour if linear else np.clip(colour, 0, layout.white)
    rounding = colour * 2.0**-11 if linear else STEEPEST * step * layout.white
    bound = rounding * mask[..., None] + colour * STEP + 1e-5
    excess = np.abs(found.image - colour * mask[..., None]) - bound
    assert excess.max() <= 0, f"{found.name}: {excess.max():.4f} beyond the quantisation"
    # A wrong transfer curve or a second alpha is a bias: rounding has none.
    assert abs(float((found.image - colour * mask[..., None]).mean())) < 0.1 * step


def save_obj(path: Path, scene: Scene, place: np.ndarray) -> None:
    """The scene's mesh, moved by a rotation, a scale and a translation (4, 4), as Wavefront OBJ."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = scene.expect_mesh()
    turned = place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (mesh.vertices @ place[:3, :3].T + place[:3, 3]).tolist()]
    lines += [f"vt {u!r} {v!r}" for u, v in mesh.uv.tolist()]
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in (mesh.normals @ turned.T).tolist()]
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in face) for face in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
