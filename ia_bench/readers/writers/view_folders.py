"""Writers of folders of one view each: NeRFactor's synthetic scenes and TensoIR-Synthetic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ia_bench.readers.writers.parts import (
    Options,
    angle_x,
    expect_central,
    held_out,
    own_light,
    save_json,
    save_lights,
    save_obj,
    save_photo,
    save_png,
    save_truth,
    unit_normals,
)
from ia_bench.scenes.scene import Scene, View

STRENGTH = 3.0  # what NeRFactor multiplies the map of the training light by


def write_tensoir(folder: Path, scene: Scene) -> Options:
    """Folders train_NNN and test_NNN; the training light's photographs are called by it and the angle that it is turned by."""
    own, others = own_light(scene, "sunset"), held_out(scene)
    expect_central("tensoir", [*scene.train, *(camera.view for camera in others)])
    for number, view in enumerate(scene.train):
        _save_view(folder / f"train_{number:03}", view, f"rgba_{own}_000.png", envmap=f"{own}.hdr")
    for number, camera in enumerate(others):
        place = folder / f"test_{number:03}"
        _save_view(place, camera.view, f"rgba_{own}_000.png", envmap=f"{own}.hdr")
        for relit in camera.relit:
            save_photo(place / f"rgba_{relit.light}.png", relit)
    save_obj(folder / "mesh.obj", scene)
    return {"light": own, **save_lights(folder, scene, own)}


def write_nerfactor(folder: Path, scene: Scene) -> Options:
    """Folders train_NNN, val_NNN (half of the held-out ones) and test_NNN; the training light is three times its map."""
    own, others = own_light(scene, "sunset"), held_out(scene)
    expect_central("nerfactor", [*scene.train, *(camera.view for camera in others)])
    light = {"envmap": f"{own}.hdr", "envmap_inten": STRENGTH}
    for number, view in enumerate(scene.train):
        _save_view(folder / f"train_{number:03}", view, "rgba.png", **light)
    half = len(others) // 2
    for number, camera in enumerate(others):
        place = folder / (f"val_{number:03}" if number < half else f"test_{number - half:03}")
        _save_view(place, camera.view, "rgba.png", **light)
        for relit in camera.relit:
            save_photo(place / f"rgba_{relit.light}.png", relit)
    save_obj(folder / "mesh.obj", scene)
    return save_lights(folder, scene, own, strength=STRENGTH)


def _save_view(folder: Path, view: View, photo: str, **light: Any) -> None:  # noqa: ANN401 (JSON)
    camera = view.camera
    matrix = ",".join(repr(float(value)) for value in camera.to_world.ravel())
    size = {"imw": camera.width, "imh": camera.height}
    save_json(folder / "metadata.json", {"cam_transform_mat": matrix, "cam_angle_x": angle_x(camera), **size, **light})
    save_photo(folder / photo, view)
    save_truth(folder / "albedo.png", view.albedo, view.mask)
    normal = unit_normals(view)
    if normal is not None:
        save_png(folder / "normal.png", 0.5 * normal + 0.5, view.mask)
