"""Writers of formats with NeRF's transforms.json: nerfstudio, Blender-NeRF, Synthetic4Relight, and Stanford-ORB."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ia_bench.light.environment import LatLongEnvironment
from ia_bench.readers.writers.parts import (
    Options,
    angle_x,
    encoded,
    expect_central,
    held_out,
    own_light,
    save_exr,
    save_json,
    save_lights,
    save_obj,
    save_photo,
    save_png,
    save_truth,
    unit_normals,
)
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Camera, Scene, View

MAP_HEIGHT = 128  # rows, at most, of the map that each photograph of Stanford-ORB has


def frame_of(view: View, path: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401 (JSON)
    """A frame of transforms.json."""
    return {"file_path": path, "transform_matrix": view.camera.to_world.tolist(), **more}


def lens_of(camera: Camera) -> dict[str, float]:
    """The intrinsics of a frame, in pixels."""
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    return {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}


def save_frames(path: Path, views: Sequence[View], frames: list[dict[str, Any]]) -> None:
    """Write the file of a split whose views have one field of view."""
    save_json(path, {"camera_angle_x": angle_x(views[0].camera), "frames": frames} if views else {"frames": []})


def write_nerfstudio(folder: Path, scene: Scene) -> Options:
    """One list of frames, intrinsics in pixels, masks in files of their own."""
    frames, names = [], dict[str, list[str]](train=[], test=[])
    for split, views in (("train", scene.train), ("test", [camera.view for camera in held_out(scene)])):
        for number, view in enumerate(views):
            name = f"{split}_{number:04}.png"
            save_png(folder / "images" / name, encoded(view))
            save_png(folder / "masks" / name, view.mask)
            frames.append(frame_of(view, f"images/{name}", mask_path=f"masks/{name}", **lens_of(view.camera)))
            names[split].append(f"images/{name}")
    shared = {key: value for key, value in lens_of(scene.train[0].camera).items() if all(frame[key] == value for frame in frames)}
    frames = [{key: value for key, value in frame.items() if key not in shared} for frame in frames]
    splits = {f"{split}_filenames": listed for split, listed in names.items()}
    save_json(folder / "transforms.json", {"camera_model": "OPENCV", **shared, **splits, "frames": frames})
    save_obj(folder / "mesh.obj", scene)
    return {}


def write_blender(folder: Path, scene: Scene) -> Options:
    """NeRF's Blender scenes: a file per split, paths without suffix, alpha in the pictures."""
    for split, views in (("train", list(scene.train)), ("test", [camera.view for camera in held_out(scene)])):
        expect_central("blender-nerf", [*scene.train[:1], *views], alike=True)
        for number, view in enumerate(views):
            save_photo(folder / split / f"r_{number}.png", view)
        frames = [frame_of(view, f"./{split}/r_{number}") for number, view in enumerate(views)]
        save_frames(folder / f"transforms_{split}.json", views, frames)
    save_obj(folder / "mesh.obj", scene)
    return {}


def write_synthetic4relight(folder: Path, scene: Scene) -> Options:
    """Linear training photographs, held-out ones in 8 bits with albedo and roughness beside them, relit ones in test_rli."""
    others, own = held_out(scene), own_light(scene, "envmap3")
    for split, views in (("train", list(scene.train)), ("test", [camera.view for camera in others])):
        expect_central("synthetic4relight", [*scene.train[:1], *views], alike=True)
        frames = [frame_of(view, f"./{split}/{number:03}") for number, view in enumerate(views)]
        save_frames(folder / f"transforms_{split}.json", views, frames)
    for number, view in enumerate(scene.train):
        save_exr(folder / "train" / f"{number:03}_rgb.exr", straight(view.image, view.mask))
        save_png(folder / "train" / f"{number:03}_mask.png", view.mask)
    for number, camera in enumerate(others):
        view, place = camera.view, folder / "test"
        save_photo(place / f"{number:03}_rgba.png", view)
        save_truth(place / f"{number:03}_albedo.png", view.albedo, view.mask)
        save_truth(place / f"{number:03}_rough.png", view.roughness, view.mask)
        for relit in camera.relit:
            save_photo(folder / "test_rli" / f"{relit.light}_{number:03}.png", relit)
    save_obj(folder / "mesh.obj", scene)
    return {"light": own, **save_lights(folder, scene, own, ".exr")}


# ---------------------------------------------------------------- Stanford-ORB
def write_stanford_orb(folder: Path, scene: Scene) -> Options:
    """One capture of the object, and held-out views of others, one for each other light, with the light as each camera sees it."""
    others = held_out(scene)
    lights = sorted({view.light for camera in others for view in camera.relit})
    captures = {light: f"object_scene{number:03}" for number, light in enumerate(["train", *lights], 1)}
    own, truth = folder / "blender_HDR" / captures["train"], folder / "ground_truth"
    for split, views in (("train", list(scene.train)), ("test", [camera.view for camera in others])):
        expect_central("stanford_orb", [*scene.train[:1], *views], alike=True)
        for number, view in enumerate(views):
            save_exr(own / split / f"{number:04}.exr", straight(view.image, view.mask))
            save_png(own / f"{split}_mask" / f"{number:04}.png", view.mask)
            if split == "test":
                _save_orb_truth(truth / captures["train"], f"{number:04}", view)
        save_frames(own / f"transforms_{split}.json", views, [frame_of(v, f"./{split}/{n:04}") for n, v in enumerate(views)])
    novel, maps = [], scene.truth.lights if scene.truth is not None else {}
    for number, camera in enumerate(others):
        for view in camera.relit:
            capture, name = captures[view.light], f"{number:04}"
            save_exr(folder / "blender_HDR" / capture / "test" / f"{name}.exr", straight(view.image, view.mask))
            save_png(folder / "blender_HDR" / capture / "test_mask" / f"{name}.png", view.mask)
            if view.light in maps:
                save_exr(truth / capture / "env_map" / f"{name}.exr", seen_around(view.camera, maps[view.light]))
            novel.append(frame_of(view, f"./test/{name}", scene_name=capture, camera_angle_x=angle_x(view.camera)))
    save_json(own / "transforms_novel.json", {"frames": novel})
    save_obj(truth / captures["train"] / "mesh_blender" / "mesh.obj", scene)
    return {"capture": captures["train"], "shrink": 1}


def _save_orb_truth(folder: Path, name: str, view: View) -> None:
    """Albedo as 8-bit sRGB, normals in the frame of the camera, depth along its axis and -1 beyond the object."""
    save_truth(folder / "pseudo_gt_albedo" / f"{name}.png", view.albedo, view.mask, srgb=True, alpha=False)
    arrays = {"surface_normal": unit_normals(view), "z_depth": view.depth}
    for kind, values in arrays.items():
        if values is not None:
            local = values @ view.camera.to_world[:3, :3] if values.ndim == 3 else straight(values, view.mask) - (view.mask <= 0)
            (folder / kind).mkdir(parents=True, exist_ok=True)
            np.save(folder / kind / f"{name}.npy", local.astype(np.float32))


def seen_around(camera: Camera, radiance: np.ndarray) -> np.ndarray:
    """A map around a camera: from its left to its right edge, it goes from behind over the left to ahead and on.

    It has twice as many rows as ``radiance``, at most MAP_HEIGHT; a texel is the mean over itself.
    """
    height = min(2 * len(radiance), MAP_HEIGHT)
    block = -(-2 * len(radiance) // height)
    rows, columns = np.mgrid[: height * block, : 2 * height * block] + 0.5
    turn, polar = (columns / (2 * height * block) - 0.5) * 2 * np.pi, rows / (height * block) * np.pi  # from ahead, and from up
    ahead, right, up = -camera.to_world[:3, 2], camera.to_world[:3, 0], camera.to_world[:3, 1]
    level = np.cos(turn)[..., None] * ahead + np.sin(turn)[..., None] * right
    directions = torch.from_numpy(np.sin(polar)[..., None] * level + np.cos(polar)[..., None] * up).float()
    found = LatLongEnvironment(torch.from_numpy(radiance)).radiance(directions).numpy()
    mean: np.ndarray = found.reshape(height, block, 2 * height, block, 3).mean((1, 3))
    return mean
