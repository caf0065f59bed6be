"""Where the mesh of a captured scene comes from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch

from ia_bench.capture.settings import MADE, CaptureSettings
from ia_bench.common.cache import Cache, content_key
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Begin, unseen
from ia_bench.geometry.consistency import MovingPhotographs
from ia_bench.geometry.grid import mesh_of, smoothed
from ia_bench.geometry.hull import visual_hull
from ia_bench.geometry.refinement import surface_from_images
from ia_bench.scenes.scene import Mesh, Scene

VERSION = 1  # of how a mesh is made: those that another one made are not taken from the cache
PARTS = ("vertices", "faces", "normals", "uv")
CAMERAS = "cameras"  # of the training views, where they have moved


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
        seen = replace(scene, mesh=None).blind()  # nothing that is made may know the truth
        made = Cache().kept(_key(seen, settings, normals), lambda: _made(seen, settings, note, normals, begin))
        mesh = Mesh(*(made[part].numpy() for part in PARTS))
        if CAMERAS in made:
            poses = zip(scene.train, made[CAMERAS].numpy(), strict=True)
            train = tuple(replace(view, camera=replace(view.camera, to_world=pose)) for view, pose in poses)
            scene = replace(scene, train=train)
    truth = scene.truth and replace(scene.truth, mesh=scene.mesh)
    return replace(scene, mesh=mesh, truth=truth, mesh_is_made=True)


def _made(
    scene: Scene, settings: CaptureSettings, note: Callable[[str], None], normals: Sequence[np.ndarray], begin: Begin
) -> dict[str, torch.Tensor]:
    sdf, from_images = settings.sdf, settings.geometry == "sdf"
    cells = sdf.cells if from_images else settings.cells
    note(f"capture.geometry={settings.geometry}: from {len(scene.train)} training views, {cells} cells a side")
    moving = MovingPhotographs(scene.train) if from_images and sdf.align else None
    known = {"exposures_differ": scene.exposures_differ, "normals": normals, "photographs": moving}
    with _to_the_bit():
        if from_images:
            options = {"tolerated": settings.tolerated, "seed": sdf.seed, "begin": begin}
            grid = surface_from_images(scene.train, cells, sdf.steps, **known, **options)  # type: ignore[arg-type]
        else:
            grid = visual_hull(scene.train, cells, settings.tolerated)
        mesh = mesh_of(grid, settings.triangles)
    made = {part: torch.from_numpy(np.ascontiguousarray(getattr(mesh, part))) for part in PARTS}
    if moving is not None:
        made[CAMERAS] = torch.from_numpy(np.stack([camera.to_world for camera in moving.cameras(scene.train)]))
    return made


@contextmanager
def _to_the_bit() -> Iterator[None]:
    """Torch with deterministic algorithms alone, whatever else is asked of it: of a run on CUDA, and of a new score, it is not.

    Textures fit no mesh but the one that they were recovered on, and another last bit of a distance may be another mesh.
    """
    before = torch.get_deterministic_debug_mode()
    torch.set_deterministic_debug_mode("error")
    try:
        yield
    finally:
        torch.set_deterministic_debug_mode(before)


def _key(scene: Scene, settings: CaptureSettings, normals: Sequence[np.ndarray]) -> str:
    """Of all that decides a mesh that is made: masks, what is known of them, cameras, sizes; of an "sdf" images and normals."""
    images = settings.geometry == "sdf"
    sizes = f"{settings.geometry} {VERSION} {settings.cells} {settings.tolerated} {settings.triangles}"
    if images:
        made = replace(settings.sdf, normals="none")  # they count by what they are, not by where they lie
        sizes = f"sdf {VERSION} {made} {settings.tolerated} {settings.triangles} {scene.exposures_differ}"
    parts: list[str | np.ndarray] = [sizes, *normals]
    for view in scene.train:
        camera = view.camera
        parts += [f"{camera.focal} {camera.centre}", camera.to_world, view.mask]
        parts += [] if view.valid is None else [view.valid]
        parts += [view.image] if images else []
    return content_key("shape", *parts)
