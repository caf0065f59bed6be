"""Writers of formats with NeRF's cameras.

transforms.json holds our own scenes, nerfstudio's, Blender-NeRF's, Synthetic4Relight and Stanford-ORB; NeRFactor's synthetic scenes
and TensoIR-Synthetic have a folder for each view.
"""

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
    flat,
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
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Camera, Scene, View

KNOWN = ("albedo", "roughness", "metallic", "specular", "normal", "depth")
VERTEX = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
STRENGTH = 3.0  # what NeRFactor multiplies the map of the training light by
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


def write_native(folder: Path, scene: Scene) -> Options:
    """OpenEXR of whole floats; textures in 8 bits, where they belong to the mesh that is written."""
    for split in ("train", "test", "novel"):
        frames, views = [], getattr(scene, split)
        unique = len({(view.light, flat(view.name)) for view in views}) == len(views)
        for number, view in enumerate(views):
            name = flat(view.name) if unique else f"{number:04}"
            name = name if view.light == "train" else f"{view.light}/{name}"
            write_exr(folder / f"images/{split}/{name}.exr", np.dstack([view.image, view.mask]), half=False)
            more = dict[str, Any](light=view.light)
            for kind in KNOWN:
                values = getattr(view, kind)
                if values is not None:
                    more[f"{kind}_path"] = f"truth/{split}/{kind}/{name}.exr"
                    write_exr(folder / more[f"{kind}_path"], values, half=False)
            frames.append(frame_of(view, f"images/{split}/{name}.exr", **lens_of(view.camera), **more))
        if frames:
            save_json(folder / f"transforms_{split}.json", {"frames": frames})
    lights, textures = dict[str, str](), dict[str, str]()
    if scene.truth is not None:
        for name, radiance in scene.truth.lights.items():
            lights[name] = f"lights/{name}.exr"
            save_exr(folder / lights[name], radiance)
        for name in ("albedo", "roughness", "metallic"):
            texture = getattr(scene.truth, name)
            if texture is not None and scene.truth.mesh is None:
                textures[name] = f"truth/{name}.png"
                save_png(folder / textures[name], linear_to_srgb(texture.clip(0, 1)) if name == "albedo" else texture)
    if scene.mesh is not None:
        mesh = scene.mesh
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n{VERTEX}"
        head += f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        faces = np.zeros(len(mesh.faces), TRIANGLE)
        faces["count"], faces["corners"] = 3, mesh.faces
        vertices = np.concatenate([mesh.vertices, mesh.normals, mesh.uv], 1).astype("<f4")
        (folder / "mesh.ply").write_bytes(head.encode() + vertices.tobytes() + faces.tobytes())
    about = {"schema": 1, "name": scene.name, "up": "z", "color_space": "linear_rec709", "metallic": scene.metallic}
    save_json(folder / "scene.json", {**about, "lights": lights, "truth_textures": textures})
    return {}


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


# ---------------------------------------------------------------- a folder a view
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
