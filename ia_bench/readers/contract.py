"""What a reader of scenes is, and the check of what it returns, where it enters. One file per format of others' data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import shown
from ia_bench.scenes.exr import BRIGHTEST, MAX_PIXELS
from ia_bench.scenes.scene import Camera, Mesh, Scene, Truth, View

SPLITS = ("train", "test", "novel")
MESHES = ("mesh.ply", "mesh.obj", "mesh.glb")
NO_MESH = f"no mesh: none of {', '.join(MESHES)} is there, and reader.options.mesh names none"
"""What a reader notes of a folder without a mesh."""
TRUTH_OF_VIEWS: dict[str, tuple[int, float, float]] = {
    "albedo": (3, 0.0, 1.0),
    "roughness": (1, 0.0, 1.0),
    "metallic": (1, 0.0, 1.0),
    "specular": (3, 0.0, np.inf),
    "normal": (3, -1.0, 1.0),
    "depth": (1, 0.0, np.inf),
}
"""The truth that a view may have: channels, least and largest value."""
ROUNDING = 0.01  # which lossy images may go beyond the ends of a range
FOCAL = 1e-3, 1e6  # focal lengths, and principal points, in widths of an image
NUMBERS = (int, float, np.integer, np.floating)
FAR = 1e12  # scene units

KINDS = {
    "name": (str, "one line of text"),
    "source": (str, "text"),
    "metallic": (bool | None, "true or false"),
    **dict.fromkeys(("exposures_differ", "white_balances_differ", "mesh_is_made"), (bool, "true or false")),
    **dict.fromkeys(("notes", *SPLITS), (tuple, "a tuple")),
}
"""Fields of a Scene whose types are asked first, with words for them: what else is said of it holds for these alone."""


@runtime_checkable
class SceneReader(Protocol):
    """A format of scenes, made by ``Reader(path, **options)``.

    ``path`` is the folder that ``scene.path`` names, absolute and there, or None where the user gave none: a reader that keeps
    or computes its data elsewhere needs none. ``options`` are ``reader.options``, whose types and ranges are checked against the
    annotations of the class where a configuration names it, as that of a command or of ``ib.load`` does. Who calls the class in
    Python goes past that check.

    A reader may also have ``label``, what tables call the scene (by default the folder's name), and ``files()``, the list of all
    files that it may read: runs are known by the content of these, or else by that of everything below ``path``. Of its options
    those that it lists in ``elsewhere`` name files and folders as a command line does; without such a list any may.
    """

    def read(self, truth: bool) -> Scene:
        """The scene, equal at every call; without ``truth``, no file that only truth needs is opened."""
        ...


def check_scene(scene: object, *, truth: bool) -> Scene:
    """The ``scene``, as a reader returned it, with an empty truth where there is none but it was asked for.

    Raises InputError for the first thing in it that is not as Scene describes it.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"expected a Scene, found {type(scene).__name__}")
    for key, (kind, words) in KINDS.items():
        value = getattr(scene, key)
        if not isinstance(value, kind):
            raise InputError(f"{shown(scene.source)}: {key}: expected {words}, found {shown(repr(value))}")
    if not (0 < len(scene.name) <= 200 and scene.name.isprintable()):
        raise InputError(f"{scene.source}: name: expected one line of text, found {shown(repr(scene.name))}")
    _check_numbers(f"{scene.source}: saturated_share", scene.saturated_share, 0, 1)
    if scene.mesh is not None:
        where, mesh = f"{scene.source}: mesh", scene.mesh
        if not isinstance(mesh, Mesh):
            raise InputError(f"{where}: expected a Mesh, found {type(mesh).__name__}")
        for part, width, least, most in (("vertices", 3, -np.inf, np.inf), ("normals", 3, -1, 1), ("uv", 2, 0, 1)):
            _check_array(f"{where}: {part}", getattr(mesh, part), (len(mesh.vertices), width), least, most)
        faces, count = mesh.faces, len(mesh.vertices)
        if faces.dtype != np.int32 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise InputError(f"{where}: faces: expected (F, 3) int32, found {faces.shape} {faces.dtype}")
        if faces.min() < 0 or faces.max() >= count:
            raise InputError(f"{where}: faces: expected vertices 0 to {count - 1}, found {faces.min()} to {faces.max()}")
    if not scene.train:
        raise InputError(f"{scene.source}: expected at least one training view, found none")
    for split in SPLITS:
        for view in getattr(scene, split):
            where = f"{scene.source}: {split} view {shown(getattr(view, 'name', view))}"
            _check_view(where, view, truth)
            for name in (view.name, view.light):
                _check_name(where, name)
            if split != "novel" and view.light != "train":
                raise InputError(f"{where}: expected the training light, which is called 'train', found {shown(repr(view.light))}")
    if scene.truth is None:
        return replace(scene, truth=Truth(lights={})) if truth else scene
    if not truth:
        raise InputError(f"{scene.source}: expected no truth, which was not asked for, found some")
    for name, light in scene.truth.lights.items():
        where, height = f"{scene.source}: light {shown(name)}", light.shape[0] if light.ndim == 3 else 0
        _check_name(where, name)
        _check_array(where, light, (height, 2 * height, 3), 0, BRIGHTEST, slack=0)
        if not light.any():
            raise InputError(f"{where}: expected radiance above 0 somewhere, found none")
    for name, channels in (("albedo", 3), ("roughness", 1), ("metallic", 1)):
        texture = getattr(scene.truth, name)
        if texture is not None:
            side = texture.shape[:1] * 2
            _check_array(f"{scene.source}: true {name} texture", texture, (*side, 3) if channels == 3 else side, 0, 1)
    return scene


def check_camera(where: str, camera: Camera) -> Camera:
    """The ``camera``, as Scene describes it. Raises InputError, naming ``where``, for numbers that no camera has."""
    for key in ("width", "height"):
        _check_numbers(f"{where}: {key}", getattr(camera, key), 1, MAX_PIXELS, kinds=(int, np.integer))
    least, most = (limit * max(camera.width, camera.height) for limit in FOCAL)
    _check_numbers(f"{where}: focal", camera.focal, least, most, count=2)
    _check_numbers(f"{where}: centre", camera.centre, -most, most, count=2)
    matrix = np.asarray(camera.to_world)
    sound = matrix.shape == (4, 4) and matrix.dtype.kind in "fi" and (np.abs(matrix) < FAR).all()
    rotation = matrix[:3, :3] if sound else np.zeros((3, 3))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 2e-3 or np.linalg.det(rotation) < 0 or matrix[3].tolist() != [0, 0, 0, 1]:
        found = shown(matrix.tolist())
        raise InputError(f"{where}: expected a rotation and a translation, camera-to-world, found {found}")
    return camera


def unscored(scene: Scene, *, aligned: bool = True) -> dict[str, str]:
    """What cannot be scored on a scene that was read with its truth: the component and what the scene lacks for it.

    ``aligned``: whether albedo is aligned to the truth before it is relit.
    """
    lights = scene.truth.lights if scene.truth is not None else {}
    lacking = {}
    for component in ("albedo", "roughness"):
        without = sum(getattr(view, component) is None for view in scene.test)
        if not scene.test or without:
            views = f"{without} of {len(scene.test)} test views have no true {component}"
            lacking[component] = views if scene.test else "no test views"
    if not any(view.light == "train" for view in scene.novel):
        lacking["view_synthesis"] = "no novel views under the training light"
    others = {view.light for view in scene.novel} - {"train"}
    if not others:
        lacking["relighting"] = "no novel views under another light"
    elif not others & lights.keys():
        lacking["relighting"] = f"no environment map of {', '.join(sorted(others))}"
    elif aligned and "albedo" in lacking:
        lacking["relighting"] = f"relit albedo is aligned to the truth first, and {lacking['albedo']}"
    return lacking


def _check_name(where: str, name: object) -> None:
    """Files are called by the names of views and lights: raise InputError for what is none, or leads out of a folder."""
    if not isinstance(name, str) or not name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(f"{where}: expected a name by which files below a folder can be called, found {shown(repr(name))}")


def _check_view(where: str, view: object, truth: bool) -> None:
    if not isinstance(view, View) or not isinstance(view.camera, Camera):
        raise InputError(f"{where}: expected a View with a Camera, found {type(view).__name__}")
    camera = check_camera(f"{where}: camera", view.camera)
    shape = camera.height, camera.width
    _check_array(f"{where}: image", view.image, (*shape, 3), 0, BRIGHTEST)
    _check_array(f"{where}: mask", view.mask, shape, 0, 1, slack=0)
    if not (view.mask > 0.5).any():
        raise InputError(f"{where}: mask: expected a pixel above 0.5, found none")
    if view.image[view.mask == 0].any():
        raise InputError(f"{where}: image: expected radiance premultiplied by the mask, found some where the mask is 0")
    if view.valid is not None:
        _check_array(f"{where}: valid", view.valid, shape, 0, 1, kind=bool)
    if view.exposure is not None:
        _check_numbers(f"{where}: exposure", view.exposure, 1 / BRIGHTEST, BRIGHTEST)
    for name, (channels, least, most) in TRUTH_OF_VIEWS.items():
        values = getattr(view, name)
        if values is not None and not truth:
            raise InputError(f"{where}: {name}: expected no truth, which was not asked for, found some")
        if values is not None:
            _check_array(f"{where}: {name}", values, (*shape, 3) if channels == 3 else shape, least, most)


def _check_numbers(where: str, value: object, least: float, most: float, count: int = 0, kinds: tuple[Any, ...] = NUMBERS) -> None:
    """Raise InputError for anything but a number of these ``kinds`` in a range, or but ``count`` of them in a tuple."""
    many = list(value) if count and isinstance(value, tuple | list | np.ndarray) else [value]
    if len(many) != max(count, 1) or not all(isinstance(one, kinds) and least <= one <= most for one in many):
        words = f"{count} numbers" if count else "a number" if kinds is NUMBERS else "a whole number"
        raise InputError(f"{where}: expected {words} from {least:g} to {most:g}, found {shown(repr(value))}")


def _check_array(
    where: str, values: object, shape: tuple[int, ...], least: float, most: float, slack: float = ROUNDING, kind: type = np.float32
) -> None:
    """Raise InputError for other shapes, types or values; ``slack`` is what rounding may add to a range, of 1 or the maximum."""
    if not isinstance(values, np.ndarray) or values.dtype != kind or values.shape != shape or not values.size:
        found = f"{values.shape} {values.dtype}" if isinstance(values, np.ndarray) else type(values).__name__
        raise InputError(f"{where}: expected {shape} {np.dtype(kind)}, found {found}")
    low, high = values.min(), values.max()
    slack *= 1 if most <= 1 else high
    if not (np.isfinite(low) and np.isfinite(high) and least - slack <= low and high <= most + slack):
        raise InputError(f"{where}: expected finite values from {least:g} to {most:g}, found {low:g} to {high:g}")
