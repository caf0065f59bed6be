"""Pictures of a run's glTF asset by an independent OpenGL renderer, off screen: what any viewer would show of it.

pyrender is imported here and nowhere else, when a picture is asked for. It draws with OSMesa on the CPU unless
``PYOPENGL_PLATFORM`` says otherwise (``egl`` on a machine with a GPU).
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError

FIELD_OF_VIEW = math.radians(35)
ELEVATION = math.radians(20)
OVERSAMPLING = 2  # along each side; averaging replaces the multisampling that OSMesa lacks
HOW_TO_GET_IT = (
    "it needs pip install freetype-py pyglet six PyOpenGL==3.1.10, then pip install --no-deps pyrender==0.1.45, "
    "and the OSMesa library (Debian: apt-get install libosmesa6)"
)


def render_preview(asset: Path, folder: Path, *, views: int = 4, size: int = 512) -> list[Path]:
    """Draw ``asset`` (glTF, y up) from ``views`` angles around it into ``folder``/preview_<degrees>.png, size x size.

    The background is transparent. Raises InputError when the asset cannot be read, or where pyrender or OSMesa is
    missing, saying how to get them.
    """
    if views < 1 or size < 1:
        raise InputError(f"expected at least one view and one pixel, found {views} views of {size} pixels")
    scene = _load(asset)
    pyrender = _pyrender()
    centre, radius = scene.bounds.mean(0), 0.5 * float(np.linalg.norm(np.ptp(scene.bounds, axis=0)))
    stage = pyrender.Scene.from_trimesh_scene(scene, bg_color=[1.0, 1.0, 1.0], ambient_light=[0.25, 0.25, 0.25])
    distance = radius / math.sin(0.5 * FIELD_OF_VIEW)
    camera = pyrender.PerspectiveCamera(FIELD_OF_VIEW, znear=distance - 1.01 * radius, zfar=distance + 1.01 * radius)
    eye = stage.add(camera)
    key = stage.add(pyrender.DirectionalLight(intensity=4.0))
    try:
        renderer = pyrender.OffscreenRenderer(OVERSAMPLING * size, OVERSAMPLING * size)
    except Exception as error:
        raise _missing(error) from None
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(views):
            azimuth = 2 * math.pi * number / views
            stage.set_pose(eye, _orbit(centre, distance, azimuth, ELEVATION))
            stage.set_pose(key, _orbit(centre, distance, azimuth - 0.6, 2 * ELEVATION))  # over the left shoulder
            colour, depth = renderer.render(stage)  # OSMesa gives no alpha, but no depth either where nothing is
            picture = np.dstack([colour, np.where(depth > 0, 255, 0).astype(np.uint8)])
            path = folder / f"preview_{round(math.degrees(azimuth)):03d}.png"
            with whole_file(path) as partial:
                Image.fromarray(picture).resize((size, size), Image.Resampling.BOX).save(partial)
            written.append(path)
    finally:
        renderer.delete()
    return written


def _load(asset: Path) -> trimesh.Scene:
    if not asset.is_file():
        raise InputError(f"{asset}: no such file; a finished run leaves it")
    try:
        scene = trimesh.load_scene(asset, process=False)
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise InputError(f"{asset}: not a readable glTF file ({type(error).__name__}: {error})") from None
    if scene.bounds is None:
        raise InputError(f"{asset}: there is nothing in it to draw")
    return scene


def _pyrender() -> Any:  # noqa: ANN401 (a module without types, imported on use)
    os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
    try:
        import pyrender
    except Exception as error:  # a missing library shows as anything from ImportError to AttributeError
        raise _missing(error) from None
    return pyrender


def _missing(error: Exception) -> InputError:
    cause = str(error).splitlines()[0] if str(error) else "no message"
    return InputError(f"preview pictures cannot be drawn ({type(error).__name__}: {cause}): {HOW_TO_GET_IT}")


def _orbit(centre: np.ndarray, distance: float, azimuth: float, elevation: float) -> np.ndarray:
    """Pose (4, 4) of an OpenGL camera that looks at ``centre``; azimuth 0 is at glTF's +z, which faces the viewer."""
    backward = np.array(
        [math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation)]
    )
    right = np.array([math.cos(azimuth), 0.0, -math.sin(azimuth)])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(backward, right), backward], 1)
    pose[:3, 3] = centre + distance * backward
    return pose
