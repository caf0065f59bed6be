"""Pictures of an object under lights of one's own, by the reference renderer: still, under a turning light, or turning.

    shown = sRGB(clip(2^EV L, 0, 1))

for radiance L and an exposure EV, which is the same for all pictures under one light. The light that falls on the object is
averaged to LIGHT_ROWS rows, as in scores; what is seen behind it is the map itself.
"""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import map_coordinates

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import Fault, InputError, first_line, unknown
from ia_bench.common.files import user_path
from ia_bench.common.machine import expect_memory
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.readers.contract import SPLITS
from ia_bench.render.asset_files import read_asset
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.settings import REFERENCE_LIGHT_ROWS as LIGHT_ROWS
from ia_bench.render.stage import Stage, camera_key
from ia_bench.runs.pictures.drawing import exposure
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import read_light
from ia_bench.scenes.images import display
from ia_bench.scenes.scene import Camera, Mesh, Scene

Background = Literal["transparent", "light", "white"]
STILL, ORBIT, TEST = "still", "orbit", "test"
"""Views that have no name: one from the side and above, the same around the object, and all that a scene holds out."""
FIELD_OF_VIEW, ELEVATION, AZIMUTH = math.radians(30), math.radians(20), math.radians(-60)
"""The angles of the camera of STILL, in front of the object (-y) and to its right."""
MARGIN = 1.05  # of the object's bounding sphere, to the picture's edge
WIDEST = 16383  # pixels of a side: as many as WebP takes
MOVING = (".webp", ".gif", ".mp4")
SECOND = 1000  # milliseconds
ENCODER = "ffmpeg"


@dataclass(frozen=True)
class RelitView:
    """One picture: seen by ``camera``, with the light turned by ``turn`` radians about z, counter-clockwise from above."""

    camera: Camera
    turn: float = 0.0


def of_run(folder: Path, device: torch.device, scene: Path | None = None) -> tuple[TexturedReconstruction, Scene]:
    """What a run recovered, and its scene, which lies in the folder ``scene`` or where the run found it.

    Raises InputError for a run without textures, and where its scene is not there.
    """
    run = Recovered(folder)
    lacking = [name for name in ("albedo.exr", "roughness.exr") if not run.has(name)]
    if lacking:
        raise InputError(f"{folder}: expected the textures of a run, found no {' and no '.join(lacking)}: its method leaves none")
    found = run.read_scene(scene)
    return run.reconstruction(Stage(found.expect_mesh(), device)), found


def of_asset(path: Path, device: torch.device, note: Callable[[str], None], up: Literal["y", "z"]) -> TexturedReconstruction:
    """A textured mesh of any program. Raises InputError as :func:`ia_bench.render.asset_files.read_asset`.

    Where its texture coordinates are none that light could bounce between, ``note`` is told, and it is drawn without that.
    """
    assets = read_asset(path, note=note, up=up)
    stage = Stage(assets.mesh, device)
    found = TexturedReconstruction.of(assets, stage)
    try:
        grey = LatLongEnvironment(torch.ones(2, 4, 3, device=device))
        found.render([_around(assets.mesh, 0.0, 2)], light=grey, albedo_scale=None, quality=Quality(1, 2))
    except InputError as error:
        note(f"without light from the object onto itself: {error}")
        return TexturedReconstruction(stage, found.material, None, bounces=0)
    return found


def light_called(name: str, scene: Scene | None, key: str) -> np.ndarray:
    """Radiance (H, 2 H, 3) of the light of a ``scene`` that is called so, or of the map in the file of this name.

    Raises InputError, naming ``key``, where there is neither.
    """
    known = {} if scene is None or scene.truth is None else scene.truth.lights
    if name in known:
        return known[name]
    if known and not Path(name).suffix:
        raise InputError(f"{unknown(key, name, known)}; or the file of a map, .hdr or .exr")
    return read_light(user_path(key, name))


def frames_of(views: str, turn: int, mesh: Mesh, scene: Scene | None, size: int) -> list[RelitView]:
    """The pictures to draw, ``size`` pixels high.

    ``views``: STILL or the name of a view of the scene, "0001" or "test/0001", with a light that turns once in ``turn`` steps;
    ORBIT, an object that turns once under a light that stands; TEST, every held-out view. Raises InputError for what the scene
    has not, and for a name of several cameras.
    """
    turns = [2 * math.pi * step / turn for step in range(turn)]
    if views == ORBIT:  # the object stands, and camera and light go round it
        return [RelitView(_around(mesh, angle, size), angle) for angle in turns]
    if views == STILL:
        return [RelitView(_around(mesh, 0.0, size), angle) for angle in turns]
    if scene is None:
        raise InputError(f"views: expected {STILL} or {ORBIT} of an asset, which has no photographs, found {views}")
    if views == TEST:
        if not scene.test:
            raise InputError(f"{scene.source}: expected held-out views for views={TEST}, found none")
        if turn > 1:
            raise InputError(f"turn: expected none with views={TEST}, found {turn}")
        return [RelitView(_sized(view.camera, size)) for view in scene.test]
    known = {f"{split}/{view.name}": view for split in SPLITS for view in getattr(scene, split)}
    found = {name: view.camera for name, view in known.items() if views in (name, view.name)}
    if not found:
        raise InputError(f"views: {unknown('view', views, [STILL, ORBIT, TEST, *known])}")
    if len({camera_key(camera) for camera in found.values()}) > 1:
        raise InputError(f"views: expected one of {', '.join(found)}, found {views}, which is the name of several cameras")
    return [RelitView(_sized(camera, size), angle) for camera in [*found.values()][:1] for angle in turns]


def draw(
    found: TexturedReconstruction,
    light: np.ndarray,
    frames: Sequence[RelitView],
    *,
    background: Background = "transparent",
    ev: float | None = None,
    quality: Quality,
    advance: Callable[[], None] = lambda: None,
) -> tuple[list[np.ndarray], float]:
    """Draw every frame under a ``light`` (H, 2 H, 3): pictures (H, W, 4) in [0, 1], sRGB with straight alpha, and their EV.

    ``ev``: None for the exposure that brings all but the brightest hundredth of the object's pixels below white. ``advance`` is
    called after each frame.
    """
    size = max(frame.camera.width * frame.camera.height for frame in frames)
    expect_memory(f"{len(frames)} pictures of {size} pixels", len(frames) * size * 32)
    radiance: list[tuple[np.ndarray, np.ndarray]] = []
    for frame in frames:
        texels = torch.from_numpy(_turned(light, frame.turn)).to(found.device)
        around = LatLongEnvironment(LatLongEnvironment(texels).latlong(min(LIGHT_ROWS, len(light))))
        drawn = found.render([frame.camera], light=around, albedo_scale=None, quality=quality)
        assert drawn is not None
        radiance.append((drawn.images[0], drawn.coverage[0].clip(0, 1)))
        advance()
    gain = exposure([image for image, _ in radiance], [mask for _, mask in radiance]) if ev is None else 2.0**ev
    shown = [_shown(*one, frame, light, background, gain) for one, frame in zip(radiance, frames, strict=True)]
    return shown, math.log2(gain)


def write_animation(path: Path, pictures: Sequence[np.ndarray], *, seconds: float) -> None:
    """Write pictures (H, W, 4) in [0, 1]: an animation of ``seconds``, or below each other where the format shows stills alone.

    Raises Fault where no program writes .mp4.
    """
    if path.suffix not in MOVING:
        widest = max(picture.shape[1] for picture in pictures)
        padded = [np.pad(picture, ((0, 0), (0, widest - picture.shape[1]), (0, 0))) for picture in pictures]
        pictures = [np.concatenate(padded)]
    bytes_ = [np.round(255 * picture).astype(np.uint8) for picture in pictures]
    if path.suffix == ".mp4":
        _encode(path, bytes_, len(bytes_) / seconds)
        return
    images = [Image.fromarray(picture if path.suffix != ".gif" else picture[..., :3]) for picture in bytes_]
    duration = round(SECOND * seconds / len(images))
    more: dict[str, Any] = {"save_all": True, "append_images": images[1:], "duration": duration, "loop": 0}
    with whole_file(path) as partial:
        images[0].save(partial, quality=90, **(more if len(images) > 1 else {}))


def expect_format(path: Path, background: Background, frames: Sequence[RelitView], lights: int) -> None:
    """Raise InputError, before anything is drawn, for a file that cannot hold the pictures of ``frames`` under so many lights."""
    if path.suffix not in (".png", *MOVING):
        raise InputError(f"--out: expected a name that ends with .png, {', '.join(MOVING)}, found {path}")
    if path.suffix in (".gif", ".mp4") and background == "transparent":
        raise InputError(f"--background: expected light or white with {path.suffix}, which has no transparency, found transparent")
    if path.suffix == ".mp4" and shutil.which(ENCODER) is None:
        raise InputError(
            f"--out: expected {ENCODER} on the PATH, which writes .mp4, found none; .webp and .gif need no other program"
        )
    sizes = {(frame.camera.height, frame.camera.width) for frame in frames}
    if path.suffix in MOVING and len(sizes) > 1:
        raise InputError(f"{path}: expected pictures of one size, found several; .png takes them")
    below = max if path.suffix in MOVING else sum
    height, width = below(frame.camera.height for frame in frames), lights * max(width for _, width in sizes)
    if max(height, width) > WIDEST:
        raise InputError(
            f"{path}: expected at most {WIDEST} pixels along a side, found {width} x {height}; --size makes it smaller"
        )
    if path.suffix == ".mp4" and len(frames) < 2:
        raise InputError("--out: expected several pictures for .mp4, as --turn 36 makes, found one")


def _shown(
    image: np.ndarray, coverage: np.ndarray, frame: RelitView, light: np.ndarray, background: Background, gain: float
) -> np.ndarray:
    """A premultiplied image (H, W, 3) as it is shown, (H, W, 4)."""
    alpha = coverage[..., None]
    if background == "transparent":
        return np.concatenate([display(image, coverage, gain), alpha], -1)
    if background == "white":
        shown = alpha * display(image, coverage, gain) + (1 - alpha)
    else:
        shown = linear_to_srgb((gain * (image + (1 - alpha) * _behind(frame, light))).clip(0, 1))
    return np.concatenate([shown, np.ones_like(alpha)], -1)


def _behind(frame: RelitView, light: np.ndarray) -> np.ndarray:
    """The light (H, W, 3) that the camera sees behind the object, bilinear between texels."""
    camera, (height, width) = frame.camera, light.shape[:2]
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y, z = np.moveaxis(camera.rays(columns, rows), -1, 0)
    polar = np.arctan2(np.hypot(x, y), z) * (height / math.pi) - 0.5
    around = (math.pi - np.arctan2(y, x) + frame.turn) % (2 * math.pi) * (width / (2 * math.pi)) - 0.5
    padded = np.concatenate([light[:, -1:], light, light[:, :1]], 1)  # around the sphere
    places = [polar.clip(0, height - 1), around + 1]
    return np.stack([map_coordinates(padded[..., c], places, order=1, mode="nearest") for c in range(3)], -1)


def _turned(light: np.ndarray, angle: float) -> np.ndarray:
    """The map turned about z by ``angle`` radians, to the nearest column."""
    return np.roll(light, -round(angle * light.shape[1] / (2 * math.pi)), axis=1)  # the azimuth falls from left to right


def _around(mesh: Mesh, angle: float, size: int) -> Camera:
    """The camera of STILL, ``angle`` radians further around the object."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm(mesh.vertices - middle, axis=1).max())
    azimuth, up = AZIMUTH + angle, np.array([0.0, 0.0, 1.0])
    away = np.array([math.cos(ELEVATION) * math.cos(azimuth), math.cos(ELEVATION) * math.sin(azimuth), math.sin(ELEVATION)])
    right = np.cross(up, away) / math.cos(ELEVATION)
    to_world = np.eye(4)
    to_world[:3, :3] = np.stack([right, np.cross(away, right), away], 1)
    to_world[:3, 3] = middle + away * (MARGIN * radius / math.sin(FIELD_OF_VIEW / 2))
    focal = size / 2 / math.tan(FIELD_OF_VIEW / 2)
    return Camera(to_world, (focal, focal), (size / 2, size / 2), size, size)


def _sized(camera: Camera, size: int) -> Camera:
    """The camera whose picture is ``size`` pixels high."""
    by = size / camera.height
    width = max(1, round(camera.width * by))
    focal, centre = ((pair[0] * by, pair[1] * by) for pair in (camera.focal, camera.centre))
    return replace(camera, focal=focal, centre=centre, width=width, height=size)


def _encode(path: Path, pictures: Sequence[np.ndarray], rate: float) -> None:
    """Hand pictures (H, W, 4) to the encoder; H.264 has even sides, so that a last row or column is left out."""
    height, width = (side // 2 * 2 for side in pictures[0].shape[:2])
    content = b"".join(picture[:height, :width, :3].tobytes() for picture in pictures)
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
    with whole_file(path) as partial:
        command = [ENCODER, "-y", "-loglevel", "error", *given, "-pix_fmt", "yuv420p", "-crf", "18", str(partial)]
        done = subprocess.run(command, input=content, capture_output=True, check=False)
        if done.returncode != 0:
            said = first_line(RuntimeError(done.stderr.decode(errors="replace")))
            raise Fault(f"{path}: {ENCODER} ended with status {done.returncode}: {said}")
