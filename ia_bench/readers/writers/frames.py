"""Writers of formats with NeRF's cameras.

transforms.json holds our own scenes, nerfstudio's, Blender-NeRF's, Synthetic4Relight and Stanford-ORB; NeRFactor's synthetic scenes
and TensoIR-Synthetic have a folder for each view.
"""

from __future__ import annotations

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
    splits_of,
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


def save_splits(folder: Path, scene: Scene, name: str, photo: str) -> dict[str, list[View]]:
    """Write transforms_train.json and transforms_test.json of the format ``name``, and return the views of both.

    ``photo`` makes a number what the photograph of that number is called in the folder of its split. Raises InputError for views
    of several fields of view.
    """
    splits = splits_of(scene)
    for split, views in splits.items():
        expect_central(name, [*scene.train[:1], *views], alike=True)
        frames = [frame_of(view, f"./{split}/{photo.format(number)}") for number, view in enumerate(views)]
        angle = {"camera_angle_x": angle_x(views[0].camera)} if views else {}
        save_json(folder / f"transforms_{split}.json", {**angle, "frames": frames})
    return splits


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
    for split, views in splits_of(scene).items():
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
    for split, views in save_splits(folder, scene, "blender-nerf", "r_{}").items():
        for number, view in enumerate(views):
            save_photo(folder / split / f"r_{number}.png", view)
    save_obj(folder / "mesh.obj", scene)
    return {}


def write_synthetic4relight(folder: Path, scene: Scene) -> Options:
    """Linear training photographs, held-out ones in 8 bits with albedo and roughness beside them, relit ones in test_rli."""
    own = own_light(scene, "envmap3")
    save_splits(folder, scene, "synthetic4relight", "{:03}")
    for number, view in enumerate(scene.train):
        save_exr(folder / "train" / f"{number:03}_rgb.exr", straight(view.image, view.mask))
        save_png(folder / "train" / f"{number:03}_mask.png", view.mask)
    for number, (view, others) in enumerate(held_out(scene)):
        place = folder / "test"
        save_photo(place / f"{number:03}_rgba.png", view)
        save_truth(place / f"{number:03}_albedo.png", view.albedo, view.mask)
        save_truth(place / f"{number:03}_rough.png", view.roughness, view.mask)
        for relit in others:
            save_photo(folder / "test_rli" / f"{relit.light}_{number:03}.png", relit)
    save_obj(folder / "mesh.obj", scene)
    return {"light": own, **save_lights(folder, scene, own, ".exr")}


# ---------------------------------------------------------------- Stanford-ORB
def write_stanford_orb(folder: Path, scene: Scene) -> Options:
    """One capture of the object, and held-out views of others, one for each other light, with the light as each camera sees it."""
    cameras = held_out(scene)
    lights = sorted({view.light for _, others in cameras for view in others})
    captures = {light: f"object_scene{number:03}" for number, light in enumerate(["train", *lights], 1)}
    own, truth = folder / "blender_HDR" / captures["train"], folder / "ground_truth"
    for split, views in save_splits(own, scene, "stanford_orb", "{:04}").items():
        for number, view in enumerate(views):
            save_exr(own / split / f"{number:04}.exr", straight(view.image, view.mask))
            save_png(own / f"{split}_mask" / f"{number:04}.png", view.mask)
            if split == "test":
                _save_orb_truth(truth / captures["train"], f"{number:04}", view)
    novel, maps = [], scene.truth.lights if scene.truth is not None else {}
    for number, (_, others) in enumerate(cameras):
        for view in others:
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
    own = own_light(scene, "sunset")
    _save_view_folders(folder, scene, "tensoir", f"rgba_{own}_000.png", 0, {"envmap": f"{own}.hdr"})
    return {"light": own, **save_lights(folder, scene, own)}


def write_nerfactor(folder: Path, scene: Scene) -> Options:
    """Folders train_NNN, val_NNN (half of the held-out ones) and test_NNN; the training light is three times its map."""
    own, half = own_light(scene, "sunset"), len(held_out(scene)) // 2
    _save_view_folders(folder, scene, "nerfactor", "rgba.png", half, {"envmap": f"{own}.hdr", "envmap_inten": STRENGTH})
    return save_lights(folder, scene, own, strength=STRENGTH)


def _save_view_folders(folder: Path, scene: Scene, name: str, photo: str, validation: int, light: dict[str, Any]) -> None:
    """Folders of the format ``name``: train_NNN, val_NNN for so many of the held-out cameras, and test_NNN for the others.

    ``photo`` is what photographs under the training ``light`` are called, of which metadata.json tells.
    """
    others = held_out(scene)
    expect_central(name, [*scene.train, *(view for view, _ in others)])
    training: list[tuple[View, list[View]]] = [(view, []) for view in scene.train]
    for split, cameras in {"train": training, "val": others[:validation], "test": others[validation:]}.items():
        for number, (view, relit) in enumerate(cameras):
            place, camera, normal = folder / f"{split}_{number:03}", view.camera, unit_normals(view)
            matrix = ",".join(repr(float(value)) for value in camera.to_world.ravel())
            size = {"imw": camera.width, "imh": camera.height}
            save_json(place / "metadata.json", {"cam_transform_mat": matrix, "cam_angle_x": angle_x(camera), **size, **light})
            save_photo(place / photo, view)
            save_truth(place / "albedo.png", view.albedo, view.mask)
            if normal is not None:
                save_png(place / "normal.png", 0.5 * normal + 0.5, view.mask)
            for other in relit:
                save_photo(place / f"rgba_{other.light}.png", other)
    save_obj(folder / "mesh.obj", scene)
