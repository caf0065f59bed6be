"""Where the mesh of a captured scene comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import torch

from ia_bench.capture.settings import MADE, CaptureSettings
from ia_bench.common.cache import Cache, content_key
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Begin, unseen
from ia_bench.common.registry import process_state_kept
from ia_bench.geometry.consistency import MovingPhotographs
from ia_bench.geometry.grid import mesh_of, smoothed
from ia_bench.geometry.hull import visual_hull
from ia_bench.geometry.refinement import surface_from_images
from ia_bench.scenes.scene import Mesh, Scene

VERSION = 4  # of how a mesh is made: those that another one made are not taken from the cache
CAMERAS = "cameras"  # of the training views, where they have moved


def with_geometry(scene: Scene, settings: CaptureSettings, note: Callable[[str], None], begin: Begin = unseen) -> Scene:
    """The scene with the mesh that ``capture.geometry`` names; the true one, where there is one, stays in the truth.

    Meshes that are made of images and masks are kept in the cache once they are finished, by the content of all; ``begin`` shows
    how far they are.

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
        made = Cache().kept(_key(seen, settings), lambda: _made(seen, settings, note, begin))
        mesh = Mesh(*(made[part.name].numpy() for part in fields(Mesh)))
        if CAMERAS in made:
            poses = zip(scene.train, made[CAMERAS].numpy(), strict=True)
            train = tuple(replace(view, camera=replace(view.camera, to_world=pose)) for view, pose in poses)
            scene = replace(scene, train=train)
    truth = scene.truth and replace(scene.truth, mesh=scene.truth.mesh or scene.mesh)
    return replace(scene, mesh=mesh, truth=truth, mesh_is_made=True)


def _made(scene: Scene, settings: CaptureSettings, note: Callable[[str], None], begin: Begin) -> dict[str, torch.Tensor]:
    sdf, from_images = settings.sdf, settings.geometry == "sdf"
    cells = sdf.cells if from_images else settings.cells
    note(f"capture.geometry={settings.geometry}: from {len(scene.train)} training views, {cells} cells a side")
    moving = MovingPhotographs(scene.train) if from_images and sdf.align else None
    turns = _turns(scene)
    known = {"exposures_differ": scene.exposures_differ, "photographs": moving, "turns": turns}
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


def _key(scene: Scene, settings: CaptureSettings) -> str:
    """Of all that decides a mesh that is made: masks, what is known of them, cameras, sizes; of an "sdf" images."""
    images = settings.geometry == "sdf"
    sizes = f"{settings.geometry} {VERSION} {settings.cells} {settings.tolerated} {settings.triangles}"
    if images:
        sizes = f"sdf {VERSION} {settings.sdf} {settings.tolerated} {settings.triangles} {scene.exposures_differ}"
    turns = _turns(scene) if images else None
    parts: list[str | np.ndarray] = [sizes, *([] if turns is None else [turns.astype(np.float32)])]
    for view in scene.train:
        camera = view.camera
        parts += [f"{camera.focal} {camera.centre}", camera.to_world, view.mask]
        parts += [] if view.valid is None else [view.valid]
        parts += [view.image] if images else []
    return content_key("shape", *parts)
