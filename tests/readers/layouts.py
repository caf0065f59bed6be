"""What round trips share: lights as formulas, photographs of a mirror ball, formats, and how far what is read back may be off.

Writers (ia_bench/readers/writers/) follow the description of a format alone and use no code of the readers; those of datasets that
nobody exports into are here. What is written is quantised as its format is, and the bounds follow from the quantisation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from shapes import unit_rays

from ia_bench.readers.writers.formats import FORMATS
from ia_bench.readers.writers.parts import (
    Options,
    Write,
    angle_x,
    encoded,
    held_out,
    intrinsics,
    save_json,
    save_obj,
    save_png,
    world_to_camera,
)
from ia_bench.scenes.exr import rgbe
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import OPENCV_AXES, Camera, Scene, Truth, View

Light = Callable[[np.ndarray], np.ndarray]
STEP = 0.5 / 255  # half of a step of 8 bits
STEEPEST = 2.28  # slope of the sRGB decoding, at 1
TINTS = {"city": (1.0, 0.8, 0.5), "night": (0.3, 0.4, 0.9)}
TRAIN_LIGHT = "sunset"
EXPOSURE = -0.5


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


def reflected(camera: Camera, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel's ray goes from a mirror ball at the origin, (H, W, 3), and which rays meet the ball, (H, W)."""
    ahead, place = unit_rays(camera), camera.to_world[:3, 3]
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


def blender_map(light: Light, height: int = 32) -> np.ndarray:
    """A light as Blender's world texture: u = 1/2 - azimuth / (2 pi) from the left, v = the angle from +z / pi from the top."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    azimuth, polar = (0.5 - u) * 2 * np.pi, v * np.pi
    return light(np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1))


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


def scene_to_write(tiny: Scene) -> Scene:
    """The shipped scene with test views that are also there under novel lights, as most datasets have them; lights by formula."""
    return with_maps(replace(tiny, novel=under_novel_lights(tiny.test)))


def with_maps(scene: Scene) -> Scene:
    """The scene with the maps of LIGHTS, the training light among them."""
    maps = {"train" if name == TRAIN_LIGHT else name: blender_map(light).astype(np.float32) for name, light in LIGHTS.items()}
    return replace(scene, truth=Truth(maps))


# ---------------------------------------------------------------- OpenIllumination
def write_openillumination(folder: Path, scene: Scene, axes: np.ndarray = OPENCV_AXES) -> Options:
    """JPEG of full chroma; OpenCV's axes."""
    for split, masks in (("train", "com_masks"), ("test", "obj_masks")):
        frames: dict[str, Any] = {}
        for number, view in enumerate(getattr(scene, split)):
            name = f"CA{number}" if split == "train" else f"NB{number}"
            place = folder / "Lights" / "013" / "raw_undistorted" / f"{name}.JPG"
            place.parent.mkdir(parents=True, exist_ok=True)
            colour = np.where(view.mask[..., None] > 0, encoded(view), 0.3)
            Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(place, format="jpeg", quality=100, subsampling=0)
            save_png(folder / "output" / masks / f"{name}.png", view.mask)
            matrix = (view.camera.to_world @ axes).tolist()
            more = {"camera_angle_x": angle_x(view.camera), "calib_imgw": view.camera.width, "light_idx": 0}
            frames[name] = {"file_path": f"./images/{name}", "transform_matrix": matrix, **more}
        save_json(folder / "output" / f"transforms_{split}.json", {"frames": frames})
    save_obj(folder / "mesh.obj", scene)
    return {"shrink": 1}


def write_openillumination_opengl(folder: Path, scene: Scene) -> Options:
    return write_openillumination(folder, scene, np.eye(4))


# ---------------------------------------------------------------- Objects With Lighting
def save_owl(folder: Path, before: str, number: int, view: View) -> None:
    colour = (straight(view.image, view.mask) * 2.0**EXPOSURE).clip(0, 1) ** (1 / 2.2)
    save_png(folder / f"{before}image_{number:04}.png", np.where(view.mask[..., None] > 0, colour, 0.3))
    save_png(folder / f"{before}mask_{number:04}.png", np.stack([view.mask] * 3, -1))
    to_camera = world_to_camera(view.camera)
    size = [[view.camera.width, view.camera.height, 3]]
    rows = np.vstack([intrinsics(view.camera, 0.5), to_camera[:, :3], to_camera[:, 3], size])
    np.savetxt(folder / f"{before}camera_{number:04}.txt", rows)


def write_objects_with_lighting(folder: Path, scene: Scene) -> Options:
    for number, view in enumerate(scene.train):
        save_owl(folder / "test", "inputs/", number, view)
    (folder / "test" / "inputs" / "exposure.txt").write_text(f"{EXPOSURE}\n")
    (folder / "test" / "env_512_rotated.hdr").write_bytes(rgbe(blender_map(LIGHTS[TRAIN_LIGHT])))
    for number, view in enumerate(owl_expected(scene).novel):
        save_owl(folder / "test", "gt_", number, view)
        (folder / "test" / f"gt_exposure_{number:04}.txt").write_text(f"{EXPOSURE}\n")
        (folder / "test" / f"gt_env_512_rotated_{number:04}.hdr").write_bytes(rgbe(blender_map(LIGHTS[NIGHT])))
    save_obj(folder / "test" / "mesh.obj", scene)
    return {}


NIGHT = "night"


def owl_expected(scene: Scene) -> Scene:
    """Each held-out photograph has a map of its own; all are of one light here."""
    novel = [view for view in scene.novel if view.light == NIGHT]
    return replace(scene, test=(), novel=tuple(replace(v, light=f"gt_{number:04}") for number, v in enumerate(novel)))


# ---------------------------------------------------------------- formats
OTHERS = {"city": "object_scene002", "night": "object_scene003"}


def orb_expected(scene: Scene) -> Scene:
    """Stanford-ORB's views under another light each have a light of their own: the map as their camera sees it."""
    relit = [(number, view) for number, (_, others) in enumerate(held_out(scene)) for view in others]
    others = tuple(replace(view, light=f"{OTHERS[view.light]}_{number:04}") for number, view in relit)
    return replace(scene, novel=(*scene.test, *others))


@dataclass(frozen=True)
class Layout:
    """A format, and what a scene is once it went through it.

    Attributes:
        name: Of the reader.
        write: Writes a scene into a folder.
        expected: The part of the scene that the format holds.
        known: Which truth of test views it holds.
        lights: Whether it has maps of lights.
        linear: Which splits are not 8-bit sRGB.
        binary: Whether a pixel is either covered or not.
        steps: How many steps of 8 bits a value may be off, for lossy files.
        white: The radiance at which 8 bits end.
        root: The folder below the written one that scene.path names.
        stands_for: The light of LIGHTS that the format's name of a novel light means.
    """

    name: str
    write: Write
    expected: Callable[[Scene], Scene] = as_written
    known: tuple[str, ...] = ()
    lights: bool = False
    linear: tuple[str, ...] = ()
    binary: bool = False
    steps: float = 1.0
    white: float = 1.0
    root: str = ""
    stands_for: Callable[[str], str] = lambda name: name

    def formula(self, name: str) -> Light:
        """The light that the format calls ``name``."""
        return LIGHTS[TRAIN_LIGHT if name == "train" else self.stands_for(name)]

    @property
    def id(self) -> str:
        """The writer's name: a reader may read more than one layout."""
        return self.write.__name__.removeprefix("write_")


ALL = ("train", "test", "novel")
ORB = {"stands_for": lambda name: next(light for light, capture in OTHERS.items() if name.startswith(capture))}
WRITTEN: Mapping[str, Mapping[str, Any]] = {
    "native": {"known": ("albedo", "roughness", "normal"), "lights": True, "linear": ALL},
    "nerfstudio": {"expected": unlit},
    "blender-nerf": {"expected": unlit},
    "tensoir": {"known": ("albedo", "normal"), "lights": True},
    "nerfactor": {"known": ("albedo", "normal"), "lights": True},
    "synthetic4relight": {"known": ("albedo", "roughness"), "lights": True, "linear": ("train",)},
    "stanford_orb": {"expected": orb_expected, "known": ("albedo", "normal"), "lights": True, "linear": ALL, **ORB},
    "neilf": {"expected": unlit, "known": ("albedo", "roughness"), "linear": ALL, "binary": True},
    "dtu": {"expected": three_held_out},
    "colmap": {"expected": three_held_out},
    "llff": {"expected": three_held_out},
}
"""Every format of ``ia-bench export``."""
LAYOUTS = (
    *(Layout(FORMATS[name].reader, FORMATS[name].write, **about) for name, about in WRITTEN.items()),
    Layout("openillumination", write_openillumination, unlit, steps=8),
    Layout("openillumination", write_openillumination_opengl, unlit, steps=8),
    Layout(
        "objects_with_lighting",
        write_objects_with_lighting,
        owl_expected,
        lights=True,
        white=2.0**-EXPOSURE,
        root="test",
        stands_for=lambda name: NIGHT,
    ),
)


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
