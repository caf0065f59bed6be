"""What writers of other formats share: held-out cameras, matrices of other conventions, and pictures, maps and meshes as files.

A writer follows the description of its format alone and uses no code of the readers, so that each can be judged by the other.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import rgbe, write_exr
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import OPENCV_AXES, Camera, Scene, View

Options = dict[str, Any]
Write = Callable[[Path, Scene], Options]
"""Writes a scene into a folder and returns the options with which our reader of the format takes it back."""
LIGHTS = "lights"  # the folder of environment maps
HELD_OUT = 8  # every so many-th photograph is held out by those who read formats without splits
OFF_CENTRE = 0.51  # pixels by which a principal point may miss the middle where a format has none


# ---------------------------------------------------------------- views
def held_out(scene: Scene) -> list[tuple[View, list[View]]]:
    """Held-out cameras, those of test views first: a photograph under the training light, and those under others.

    The first has the truth of a test view. A camera without one is left out.
    """
    cameras: dict[tuple[bytes | float, ...], list[View]] = {}
    for view in (*scene.test, *scene.novel):
        camera = view.camera
        same = camera.to_world.tobytes(), *camera.focal, *camera.centre, camera.width, camera.height
        cameras.setdefault(same, []).append(view)
    found = []
    for views in cameras.values():
        lit = [view for view in views if view.light == "train"]
        if lit:
            relit = {view.light: view for view in views if view.light != "train"}
            found.append((lit[0], list(relit.values())))
    return found


def splits_of(scene: Scene) -> dict[str, list[View]]:
    """The photographs under the training light that are for training ("train"), and those that are held out ("test")."""
    return {"train": [*scene.train], "test": [view for view, _ in held_out(scene)]}


def lit_and_held_out(scene: Scene) -> list[View]:
    """Held-out photographs under the training light: of the views that have a true albedo, or of all where none has."""
    views = splits_of(scene)["test"]
    return [view for view in views if view.albedo is not None] or views


def mixed(scene: Scene) -> tuple[list[View], Options]:
    """All photographs under the training light in one list, and the option that tells a reader every how many-th is held out.

    It is every 8th, from the first on, where there are as many; otherwise fewer, or every more-th.
    """
    train, others = list(scene.train), lit_and_held_out(scene)
    wanted = -(-len(train) // (HELD_OUT - 1))
    for count in range(min(wanted, len(others)), 0, -1):
        total = len(train) + count
        every = HELD_OUT if count == wanted else -(-total // count)
        if len(range(0, total, every)) == count and every >= 2:
            rest, kept = iter(train), (others[number * len(others) // count] for number in range(count))
            views = [next(rest) if place % every else next(kept) for place in range(total)]
            return views, {} if every == HELD_OUT else {"every": every}
    return train, {}


def own_light(scene: Scene, name: str) -> str:
    """What the training light is called in a format that calls it ``name`` as a rule: that, unless another light is called so."""
    return name if name not in {view.light for view in scene.novel} else "train"


# ---------------------------------------------------------------- cameras
def angle_x(camera: Camera) -> float:
    """What a camera sees across, in radians."""
    return 2 * float(np.arctan(0.5 * camera.width / camera.focal[0]))


def world_to_camera(camera: Camera, size: float = 1.0, middle: np.ndarray | float = 0.0) -> np.ndarray:
    """R and t of OpenCV, x_camera = R x + t (3, 4), in a world of other units: there, the object is ``size`` times ours."""
    rotation = (camera.to_world @ OPENCV_AXES)[:3, :3].T
    return np.c_[rotation, -rotation @ (size * camera.position + middle)]


def intrinsics(camera: Camera, first_pixel: float) -> np.ndarray:
    """K, with the centre of the first pixel at ``first_pixel``."""
    shift = 0.5 - first_pixel
    return np.array([[camera.focal[0], 0, camera.centre[0] - shift], [0, camera.focal[1], camera.centre[1] - shift], [0, 0, 1]])


def expect_central(name: str, views: Sequence[View], *, alike: bool = False) -> None:
    """Raise InputError for a camera that the format ``name`` cannot hold: one focal length, and no principal point.

    ``alike``: all views have one field of view and one size.
    """
    first = views[0].camera
    for view in views:
        camera = view.camera
        off = max(abs(camera.centre[0] - camera.width / 2), abs(camera.centre[1] - camera.height / 2))
        alone = off > OFF_CENTRE or abs(camera.focal[0] / camera.focal[1] - 1) > 1e-3
        other = (camera.width, camera.height) != (first.width, first.height) or abs(camera.focal[0] / first.focal[0] - 1) > 1e-6
        if alone or (alike and other):
            found = f"{camera.focal}, {camera.centre}" if alone else "another camera than the first view's"
            raise InputError(
                f"--format {name}: expected views of one focal length whose principal point is the middle, found {found} in view "
                f"{view.name}; nerfstudio, colmap and dtu hold every camera"
            )


# ---------------------------------------------------------------- files
def flat(name: str) -> str:
    """The name of a view as that of a file in one folder."""
    return name.replace("/", "_")


def save_json(path: Path, content: object) -> None:
    """Write JSON, with the folders that lead to it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1))


def save_png(path: Path, colour: np.ndarray, alpha: np.ndarray | None = None) -> None:
    """Write 8 bits of values from 0 to 1: (H, W) or (H, W, 3), with alpha (H, W) or without."""
    path.parent.mkdir(parents=True, exist_ok=True)
    layers = colour if alpha is None else np.concatenate([colour, alpha[..., None]], -1)
    Image.fromarray(np.round(np.clip(layers, 0, 1) * 255).astype(np.uint8)).save(path)


def encoded(view: View) -> np.ndarray:
    """The colours of a photograph in sRGB, straight, black beyond the object."""
    return linear_to_srgb(straight(view.image, view.mask).clip(0, 1))


def save_photo(path: Path, view: View) -> None:
    """Write a photograph as Blender saves it: 8-bit sRGB, straight alpha."""
    save_png(path, encoded(view), view.mask)


def save_bare_photo(path: Path, view: View) -> None:
    """Write a photograph as 8-bit sRGB without a mask, grey where nothing is."""
    save_png(path, np.where(view.mask[..., None] > 0, encoded(view), 0.3))


def save_exr(path: Path, image: np.ndarray) -> None:
    """Write a linear picture (H, W, 3) in half floats, or in whole ones where those do not reach."""
    write_exr(path, image, half=bool(image.max(initial=0) <= np.finfo(np.float16).max))


def save_truth(path: Path, values: np.ndarray | None, mask: np.ndarray, *, srgb: bool = False, alpha: bool = True) -> None:
    """Write what is known of a view, albedo or roughness premultiplied by ``mask``, straight in 8 bits; nothing for None."""
    if values is not None:
        plain = straight(values, mask)
        plain = plain if plain.ndim == 3 else np.stack([plain] * 3, -1)
        save_png(path, linear_to_srgb(plain.clip(0, 1)) if srgb else plain, mask if alpha else None)


def unit_normals(view: View) -> np.ndarray | None:
    """The true normals of a view at unit length, (H, W, 3); 0 beyond the object."""
    if view.normal is None:
        return None
    return view.normal / np.maximum(np.linalg.norm(view.normal, axis=-1, keepdims=True), 1e-9)


def save_lights(folder: Path, scene: Scene, own: str, suffix: str = ".hdr", strength: float = 1.0) -> Options:
    """Write the environment maps LIGHT.hdr or .exr below ``folder``, the training light's, called ``own``, over ``strength``.

    Returns the option of our readers that names them; none where there are none.
    """
    maps = scene.truth.lights if scene.truth is not None else {}
    for name, radiance in maps.items():
        values = radiance / strength if name == "train" else radiance
        path = folder / LIGHTS / f"{own if name == 'train' else name}{suffix}"
        if suffix == ".exr":
            save_exr(path, values)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(rgbe(values))
    return {"lights": str(folder / LIGHTS)} if maps else {}


def save_obj(path: Path, scene: Scene, place: np.ndarray | None = None) -> None:
    """Write the scene's mesh, moved by a rotation, a scale and a translation (4, 4), as Wavefront OBJ; nothing if it has none."""
    if scene.mesh is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    place = np.eye(4) if place is None else place
    vertices = scene.mesh.vertices @ place[:3, :3].T + place[:3, 3]
    normals = scene.mesh.normals @ (place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))).T
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"vt {u!r} {v!r}" for u, v in scene.mesh.uv.tolist()]
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in normals.tolist()]
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in face) for face in (scene.mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
