"""Where the mesh of a captured scene comes from, and normals that another program has estimated: an input of ``sdf``.

One picture for each training view holds the camera's normals: x to the right, y up, z toward the camera, as OpenGL has it, so that
wrong poses do not turn them. A PNG holds (n + 1) / 2 in 8 bits, OpenEXR (R, G, B) and .npy (H, W, 3) hold n itself; vectors
shorter than a half say nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import torch

from ia_bench.capture.settings import MADE, CaptureSettings
from ia_bench.common.cache import Cache, content_key
from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, user_path
from ia_bench.common.progress import Begin, unseen
from ia_bench.common.registry import process_state_kept
from ia_bench.geometry.consistency import MovingPhotographs
from ia_bench.geometry.grid import mesh_of, smoothed
from ia_bench.geometry.hull import visual_hull
from ia_bench.geometry.refinement import surface_from_images
from ia_bench.scenes.photograph import read_stored
from ia_bench.scenes.scene import Mesh, Scene, View

VERSION = 4  # of how a mesh is made: those that another one made are not taken from the cache
CAMERAS = "cameras"  # of the training views, where they have moved
SETTING = "capture.sdf.normals"
SUFFIXES = ".png", ".exr", ".npy"
KNOWN = 0.5  # length from which a stored vector is a normal; that of the code for nothing, grey, is .007
UNIT = 0.1  # by which the median length of normals may differ from 1
SOLID = 0.9  # coverage from which a pixel shows nothing but the object


def with_geometry(
    scene: Scene,
    settings: CaptureSettings,
    note: Callable[[str], None],
    normals: Sequence[np.ndarray],
    begin: Begin = unseen,
) -> Scene:
    """The scene with the mesh that ``capture.geometry`` names; the true one, where there is one, stays in the truth.

    ``normals`` of each training view, or of none, are what an "sdf" follows besides its image. Meshes that are made of
    images and masks are kept in the cache once they are finished, by the content of all; ``begin`` shows how far they are.

    Raises InputError where there is nothing to make one of.
    """
    kind = settings.geometry
    if kind not in MADE and scene.mesh is None:
        raise InputError(
            f"capture.geometry={kind}: expected a mesh in {scene.source}, found none; "
            "capture.geometry=hull makes one from the masks of the training views"
        )
    if kind == "given":
        return scene
    if kind == "smoothed":
        given = scene.expect_mesh()
        mesh = smoothed(given, settings.smoothing * float(np.linalg.norm(np.ptp(given.vertices, axis=0))))
    else:
        if scene.mesh is not None:
            note(f"capture.geometry={kind}: the mesh of {scene.source} is not used; capture.geometry=given takes it")
        seen = replace(scene, mesh=None).blind()  # nothing that is made may know the truth
        made = Cache().kept(_key(seen, settings, normals), lambda: _made(seen, settings, note, normals, begin))
        mesh = Mesh(*(made[part.name].numpy() for part in fields(Mesh)))
        if CAMERAS in made:
            poses = zip(scene.train, made[CAMERAS].numpy(), strict=True)
            train = tuple(replace(view, camera=replace(view.camera, to_world=pose)) for view, pose in poses)
            scene = replace(scene, train=train)
    truth = scene.truth and replace(scene.truth, mesh=scene.truth.mesh or scene.mesh)
    return replace(scene, mesh=mesh, truth=truth, mesh_is_made=True)


def _made(
    scene: Scene, settings: CaptureSettings, note: Callable[[str], None], normals: Sequence[np.ndarray], begin: Begin
) -> dict[str, torch.Tensor]:
    sdf, from_images = settings.sdf, settings.geometry == "sdf"
    cells = sdf.cells if from_images else settings.cells
    note(f"capture.geometry={settings.geometry}: from {len(scene.train)} training views, {cells} cells a side")
    moving = MovingPhotographs(scene.train) if from_images and sdf.align else None
    turns = _turns(scene)
    known = {"exposures_differ": scene.exposures_differ, "normals": normals, "photographs": moving, "turns": turns}
    with process_state_kept():
        torch.set_deterministic_debug_mode("error")  # whatever a run asks for: textures fit the one mesh that they were made on
        if from_images:
            options = {"tolerated": settings.tolerated, "seed": sdf.seed, "begin": begin}
            grid = surface_from_images(scene.train, cells, sdf.steps, **known, **options)  # type: ignore[arg-type]
        else:
            grid = visual_hull(scene.train, cells, settings.tolerated)
        mesh = mesh_of(grid, settings.triangles)
    made = {name: torch.from_numpy(np.ascontiguousarray(part)) for name, part in vars(mesh).items()}
    if moving is not None:
        made[CAMERAS] = torch.from_numpy(np.stack([camera.to_world for camera in moving.cameras(scene.train)]))
    return made


def _turns(scene: Scene) -> np.ndarray | None:
    """How the light of the training views has turned, (V, 3, 3); None where it stands still."""
    if scene.turning is None:
        return None
    return scene.turning.rotations(np.stack([view.camera.to_world for view in scene.train]))


def _key(scene: Scene, settings: CaptureSettings, normals: Sequence[np.ndarray]) -> str:
    """Of all that decides a mesh that is made: masks, what is known of them, cameras, sizes; of an "sdf" images and normals."""
    images = settings.geometry == "sdf"
    sizes = f"{settings.geometry} {VERSION} {settings.cells} {settings.tolerated} {settings.triangles}"
    if images:
        made = replace(settings.sdf, normals="none")  # they count by what they are, not by where they lie
        sizes = f"sdf {VERSION} {made} {settings.tolerated} {settings.triangles} {scene.exposures_differ}"
    turns = _turns(scene) if images else None
    parts: list[str | np.ndarray] = [sizes, *normals, *([] if turns is None else [turns.astype(np.float32)])]
    for view in scene.train:
        camera = view.camera
        parts += [f"{camera.focal} {camera.centre}", camera.to_world, view.mask]
        parts += [] if view.valid is None else [view.valid]
        parts += [view.image] if images else []
    return content_key("shape", *parts)


# ---------------------------------------------------------------- given normals
def given_normals(text: str, views: Sequence[View]) -> list[np.ndarray]:
    """Unit normals (H, W, 3) float32 of every view, each in its camera's axes, from the folder ``text``; 0 where none is known.

    Raises InputError where one is missing, has another size or other lengths, or looks away from the camera that sees it.
    """
    folder, found, facing = user_path(SETTING, text, folder=True), [], []
    for view in views:
        normals = _normals_of(view, folder)
        rows, columns = np.nonzero((view.mask > SOLID) & (normals != 0).any(-1))
        toward = -view.camera.rays(columns + 0.5, rows + 0.5) @ view.camera.to_world[:3, :3]
        facing.append(float(((normals[rows, columns] * toward).sum(-1) > 0).mean()))  # what a camera sees faces it
        found.append(normals)
    if (share := float(np.mean(facing))) < 0.5:
        raise InputError(
            f"{SETTING}={text}: expected normals of the camera (x to the right, y up, z toward it), found that {1 - share:.0%} of "
            "them look away from it, as those of the world do, or those in OpenCV's axes"
        )
    return found


def _normals_of(view: View, folder: Path) -> np.ndarray:
    names = [f"{view.name}{suffix}" for suffix in SUFFIXES]
    there = [name for name in names if (folder / name).is_file()]
    if len(there) != 1:
        raise InputError(
            f"{folder}: expected one of {', '.join(names)} for training view {view.name}, found {' and '.join(there) or 'none'}"
        )
    path = file_below(folder, there[0], SETTING)
    stored = read_stored(path)
    if path.suffix == ".png":
        stored = np.where(stored[..., 3:] > KNOWN if stored.shape[-1] == 4 else True, 2 * stored[..., :3] - 1, 0)
    stored = stored[..., :3]
    (height, width), block = view.mask.shape, stored.shape[0] // view.mask.shape[0]
    if block == 0 or stored.shape[:2] != (block * height, block * width):
        size, found = f"{width} x {height}", f"{stored.shape[1]} x {stored.shape[0]}"
        raise InputError(f"{path}: expected {size} pixels like the training view, or a multiple of these, found {found}")
    normals = stored.reshape(height, block, width, block, 3).mean((1, 3))
    length = np.linalg.norm(stored, axis=-1).reshape(height, block, width, block).mean((1, 3))
    solid = (view.mask > SOLID) & (length > KNOWN)
    if not solid.any():
        raise InputError(f"{path}: expected normals where the mask shows the object, found none")
    if abs(np.median(length[solid]) - 1) > UNIT:
        raise InputError(f"{path}: expected unit normals, found a median length of {np.median(length[solid]):.2f}")
    mean = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(mean > KNOWN, normals / np.maximum(mean, KNOWN), 0).astype(np.float32)
