"""Writers of formats with calibrated cameras: projections, world-to-camera matrices, rows of numbers, COLMAP's text."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from nerf_writers import frame_of, relit_views
from PIL import Image
from scipy.spatial.transform import Rotation
from written import (
    LIGHTS,
    TRAIN_LIGHT,
    Layout,
    angle_x,
    blender_map,
    save_exr,
    save_hdr,
    save_json,
    save_obj,
    save_png,
    straight,
    three_held_out,
    to_srgb,
    unlit,
)

from ia_bench.scenes.scene import Camera, Scene, View

SIZE, MIDDLE = 40.0, np.array([100.0, -50.0, 600.0])  # where DTU's units have the object
BOX, CENTRE = 1.3, np.array([0.1, -0.2, 0.3])  # and NeILF's
EXPOSURE = -0.5
OTHERS = {"city": "tiny_scene002", "night": "tiny_scene003"}
FLIP = np.diag([1.0, -1, -1, 1])


def world_to_camera(camera: Camera, size: float = 1.0, middle: np.ndarray | float = 0.0) -> np.ndarray:
    """R and t of OpenCV, x_camera = R x + t (3, 4), in a world of other units: there, the object is ``size`` times ours."""
    rotation = (camera.to_world[:3, :3] @ np.diag([1, -1, -1])).T
    return np.c_[rotation, -rotation @ (size * camera.to_world[:3, 3] + middle)]


def intrinsics(camera: Camera, first_pixel: float) -> np.ndarray:
    """K, with the centre of the first pixel at ``first_pixel``."""
    shift = 0.5 - first_pixel
    return np.array([[camera.focal[0], 0, camera.centre[0] - shift], [0, camera.focal[1], camera.centre[1] - shift], [0, 0, 1]])


def every_eighth(scene: Scene) -> list[View]:
    """Nineteen photographs of which those numbered 0, 8 and 16 are test views."""
    train = list(scene.train)
    return [scene.test[0], *train[:7], scene.test[1], *train[7:14], scene.test[2], *train[14:]]


def save_bare_photo(path: Path, view: View) -> None:
    """8-bit sRGB without a mask, grey where nothing is."""
    colour = to_srgb(straight(view.image, view.mask))
    save_png(path, np.where(view.mask[..., None] > 0, colour, 0.3))


# ---------------------------------------------------------------- IDR
def write_dtu(folder: Path, scene: Scene) -> None:
    scale = np.diag([SIZE, SIZE, SIZE, 1.0])
    scale[:3, 3] = MIDDLE
    matrices = {}
    for number, view in enumerate(every_eighth(scene)):
        save_bare_photo(folder / "image" / f"{number:03}.png", view)
        save_png(folder / "mask" / f"{number:03}.png", np.stack([view.mask] * 3, -1))
        projection = intrinsics(view.camera, 0.0) @ world_to_camera(view.camera, SIZE, MIDDLE)
        matrices[f"world_mat_{number}"] = np.vstack([projection, [0, 0, 0, 1]])
        matrices[f"scale_mat_{number}"] = scale
        matrices[f"world_mat_inv_{number}"] = np.linalg.inv(matrices[f"world_mat_{number}"])
    np.savez(folder / "cameras.npz", **matrices)
    save_obj(folder / "mesh.obj", scene, scale)


# ---------------------------------------------------------------- COLMAP
def write_colmap(folder: Path, scene: Scene) -> None:
    images, sparse = [], folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    for number, view in enumerate(every_eighth(scene), 1):
        name = f"{number:04}.png"
        save_bare_photo(folder / "images" / name, view)
        save_png(folder / "masks" / f"{name}.png", view.mask)
        to_camera = world_to_camera(view.camera)
        x, y, z, w = Rotation.from_matrix(to_camera[:, :3]).as_quat()
        values = " ".join(repr(float(value)) for value in (w, x, y, z, *to_camera[:, 3]))
        images.append(f"{number} {values} 1 {name}\n\n")
    camera = scene.train[0].camera
    numbers = " ".join(repr(float(value)) for value in (*camera.focal, *camera.centre, 0, 0, 0, 0))
    (sparse / "cameras.txt").write_text(f"# a comment\n1 OPENCV {camera.width} {camera.height} {numbers}\n")
    (sparse / "images.txt").write_text("".join(images))
    (sparse / "points3D.txt").write_text("")


# ---------------------------------------------------------------- NeILF
def write_neilf(folder: Path, scene: Scene) -> None:
    """Four of twenty photographs are held out; a pixel is covered or it is not."""
    held_out = dict(zip((2, 9, 10, 18), scene.test, strict=True))
    train = iter(scene.train)
    files, images = {}, {}
    for number in range(20):
        view = held_out.get(number) or next(train)
        name = f"{number:03}"
        covered = view.mask > 0.5
        save_exr(folder / "inputs" / "images" / f"{name}.exr", straight(view.image, view.mask))
        save_exr(folder / "inputs" / "position_maps" / f"{name}.exr", covered[..., None] * np.array([0.4, -1.0, 0.1]))
        extrinsic = np.vstack([world_to_camera(view.camera, BOX, CENTRE), [0, 0, 0, 1]]).ravel().tolist()
        camera = {"intrinsic": {"focal": list(view.camera.focal), "ppt": list(view.camera.centre)}, "extrinsic": extrinsic}
        files[str(number)] = f"somewhere/else/{name}.exr"
        images[str(number)] = {"flg": 2, "size": [view.camera.width, view.camera.height], "camera": camera}
        if view.roughness is not None and view.albedo is not None:
            truth = folder / "ground_truths" / "materials"
            save_png(truth / "kd" / f"{name}.png", straight(view.albedo, view.mask))
            save_png(truth / "roughness" / f"{name}.png", straight(view.roughness, view.mask))
    box = np.diag([2 * BOX, 2.0, 1.0, 1.0])
    box[:3, 3] = CENTRE
    save_json(
        folder / "inputs" / "sfm_scene.json",
        {"image_path": {"file_paths": files}, "camera_track_map": {"images": images}, "bbox": {"transform": box.ravel().tolist()}},
    )
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # (x, z, -y): +y up
    place = np.diag([BOX, BOX, BOX, 1.0])
    place[:3, 3] = CENTRE
    save_obj(folder / "inputs" / "model" / "mesh.obj", scene, upright @ place)


# ---------------------------------------------------------------- OpenIllumination
def write_openillumination(folder: Path, scene: Scene, axes: np.ndarray = FLIP) -> None:
    """JPEG of full chroma; OpenCV's axes."""
    for split, masks in (("train", "com_masks"), ("test", "obj_masks")):
        frames: dict[str, Any] = {}
        for number, view in enumerate(getattr(scene, split)):
            name = f"CA{number}" if split == "train" else f"NB{number}"
            place = folder / "Lights" / "013" / "raw_undistorted" / f"{name}.JPG"
            place.parent.mkdir(parents=True, exist_ok=True)
            colour = np.where(view.mask[..., None] > 0, to_srgb(straight(view.image, view.mask)), 0.3)
            Image.fromarray(np.round(255 * colour).astype(np.uint8)).save(place, format="jpeg", quality=100, subsampling=0)
            save_png(folder / "output" / masks / f"{name}.png", view.mask)
            matrix = (view.camera.to_world @ axes).tolist()
            more = {"camera_angle_x": angle_x(view.camera), "calib_imgw": view.camera.width, "light_idx": 0}
            frames[name] = {"file_path": f"./images/{name}", "transform_matrix": matrix, **more}
        save_json(folder / "output" / f"transforms_{split}.json", {"frames": frames})


def write_openillumination_opengl(folder: Path, scene: Scene) -> None:
    write_openillumination(folder, scene, np.eye(4))


# ---------------------------------------------------------------- Objects With Lighting
def save_owl(folder: Path, before: str, number: int, view: View) -> None:
    colour = (straight(view.image, view.mask) * 2.0**EXPOSURE).clip(0, 1) ** (1 / 2.2)
    save_png(folder / f"{before}image_{number:04}.png", np.where(view.mask[..., None] > 0, colour, 0.3))
    save_png(folder / f"{before}mask_{number:04}.png", np.stack([view.mask] * 3, -1))
    to_camera = world_to_camera(view.camera)
    size = [[view.camera.width, view.camera.height, 3]]
    rows = np.vstack([intrinsics(view.camera, 0.5), to_camera[:, :3], to_camera[:, 3], size])
    np.savetxt(folder / f"{before}camera_{number:04}.txt", rows)


def write_objects_with_lighting(folder: Path, scene: Scene) -> None:
    for number, view in enumerate(scene.train):
        save_owl(folder / "test", "inputs/", number, view)
    (folder / "test" / "inputs" / "exposure.txt").write_text(f"{EXPOSURE}\n")
    save_hdr(folder / "test" / "env_512_rotated.hdr", blender_map(LIGHTS[TRAIN_LIGHT]))
    for number, view in enumerate(owl_expected(scene).novel):
        save_owl(folder / "test", "gt_", number, view)
        (folder / "test" / f"gt_exposure_{number:04}.txt").write_text(f"{EXPOSURE}\n")
        save_hdr(folder / "test" / f"gt_env_512_rotated_{number:04}.hdr", blender_map(LIGHTS[NIGHT]))


NIGHT = "night"


def owl_expected(scene: Scene) -> Scene:
    """Each held-out photograph has a map of its own; all are of one light here."""
    novel = [view for view in scene.novel if view.light == NIGHT]
    return replace(scene, test=(), novel=tuple(replace(v, light=f"gt_{number:04}") for number, v in enumerate(novel)))


# ---------------------------------------------------------------- Stanford-ORB
def write_stanford_orb(folder: Path, scene: Scene) -> None:
    """One capture of the object, and held-out views of two others, each with its light as its camera sees it."""
    own, truth = folder / "blender_HDR" / "tiny_scene001", folder / "ground_truth"
    for split in ("train", "test"):
        views = getattr(scene, split)
        for number, view in enumerate(views):
            save_exr(own / split / f"{number:04}.exr", straight(view.image, view.mask))
            save_png(own / f"{split}_mask" / f"{number:04}.png", view.mask)
            if split == "test" and view.albedo is not None:
                save_orb_truth(truth / "tiny_scene001", f"{number:04}", view)
        frames = [frame_of(view, f"./{split}/{number:04}") for number, view in enumerate(views)]
        save_json(own / f"transforms_{split}.json", {"camera_angle_x": angle_x(views[0].camera), "frames": frames})
    novel = []
    for number, test in enumerate(scene.test):
        for view in relit_views(scene, test):
            other, name = OTHERS[view.light], f"{number:04}"
            save_exr(folder / "blender_HDR" / other / "test" / f"{name}.exr", straight(view.image, view.mask))
            save_png(folder / "blender_HDR" / other / "test_mask" / f"{name}.png", view.mask)
            save_exr(truth / other / "env_map" / f"{name}.exr", seen_around(view.camera, view.light))
            novel.append(frame_of(view, f"./test/{name}", scene_name=other, camera_angle_x=angle_x(view.camera)))
    save_json(own / "transforms_novel.json", {"frames": novel})
    save_obj(truth / "tiny_scene001" / "mesh_blender" / "mesh.obj", scene, np.eye(4))


def save_orb_truth(folder: Path, name: str, view: View) -> None:
    """Albedo as 8-bit sRGB, normals in the frame of the camera, depth along its axis and -1 beyond the object."""
    assert view.albedo is not None
    assert view.normal is not None
    save_png(folder / "pseudo_gt_albedo" / f"{name}.png", to_srgb(straight(view.albedo, view.mask)))
    normal = straight(view.normal, view.mask)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    for kind, values in (
        ("surface_normal", unit @ view.camera.to_world[:3, :3]),
        ("z_depth", np.where(view.mask > 0, 3.0, -1.0)),
    ):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        np.save(folder / kind / f"{name}.npy", values.astype(np.float32))


def seen_around(camera: Camera, light: str, height: int = 32) -> np.ndarray:
    """A light around a camera: from its left to its right edge, the map goes from behind over the left to ahead and on."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    turn, polar = (u - 0.5) * 2 * np.pi, v * np.pi  # from straight ahead toward the right, and from up
    ahead, right, up = -camera.to_world[:3, 2], camera.to_world[:3, 0], camera.to_world[:3, 1]
    level = np.cos(turn)[..., None] * ahead + np.sin(turn)[..., None] * right
    return LIGHTS[light](np.sin(polar)[..., None] * level + np.cos(polar)[..., None] * up)


def orb_expected(scene: Scene) -> Scene:
    relit = [(number, v) for number, test in enumerate(scene.test) for v in relit_views(scene, test)]
    others = tuple(replace(v, light=f"{OTHERS[v.light]}_{number:04}") for number, v in relit)
    return replace(scene, novel=(*scene.test, *others))


LAYOUTS = (
    Layout("dtu", write_dtu, three_held_out, own_mesh=True),
    Layout("colmap", write_colmap, three_held_out),
    Layout(
        "neilf",
        write_neilf,
        unlit,
        known=("albedo", "roughness"),
        linear=("train", "test", "novel"),
        binary=True,
        own_mesh=True,
        options=lambda folder: {"validation": [2, 9, 10, 18]},
    ),
    Layout("openillumination", write_openillumination, unlit, options=lambda folder: {"shrink": 1}, steps=8),
    Layout("openillumination", write_openillumination_opengl, unlit, options=lambda folder: {"shrink": 1}, steps=8),
    Layout(
        "objects_with_lighting",
        write_objects_with_lighting,
        owl_expected,
        lights=True,
        white=2.0**-EXPOSURE,
        root="test",
        stands_for=lambda name: NIGHT,
    ),
    Layout(
        "stanford_orb",
        write_stanford_orb,
        orb_expected,
        known=("albedo", "normal"),
        lights=True,
        options=lambda folder: {"capture": "tiny_scene001", "shrink": 1},
        linear=("train", "test", "novel"),
        own_mesh=True,
        stands_for=lambda name: next(light for light, capture in OTHERS.items() if name.startswith(capture)),
    ),
)
