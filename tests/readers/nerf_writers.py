"""Writers of formats with NeRF's transforms.json, and of folders of one view each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from written import (
    LIGHTS,
    TINTS,
    TRAIN_LIGHT,
    Layout,
    angle_x,
    blender_map,
    save_exr,
    save_hdr,
    save_json,
    save_photo,
    save_png,
    straight,
    to_srgb,
    unlit,
)

from ia_bench.scenes.scene import Scene, View


# ---------------------------------------------------------------- nerfstudio
def frame_of(view: View, path: str, **more: Any) -> dict[str, Any]:
    return {"file_path": path, "transform_matrix": view.camera.to_world.tolist(), **more}


def write_nerfstudio(folder: Path, scene: Scene) -> None:
    """nerfstudio: one list of frames, intrinsics in pixels, masks in files of their own."""
    frames, names = [], {"train": [], "test": []}
    for split in names:
        for view in getattr(scene, split):
            path = f"images/{split}_{view.name}.png"
            save_png(folder / path, to_srgb(straight(view.image, view.mask)))
            save_png(folder / "masks" / f"{split}_{view.name}.png", view.mask)
            frames.append(frame_of(view, path, mask_path=f"masks/{split}_{view.name}.png"))
            names[split].append(path)
    camera = scene.train[0].camera
    intrinsics = {"fl_x": camera.focal[0], "fl_y": camera.focal[1], "cx": camera.centre[0], "cy": camera.centre[1]}
    shared = {"camera_model": "OPENCV", **intrinsics, "w": camera.width, "h": camera.height, "k1": 0.0, "p2": 0.0}
    splits = {"train_filenames": names["train"], "test_filenames": names["test"]}
    save_json(folder / "transforms.json", {**shared, **splits, "frames": frames})


def write_blender(folder: Path, scene: Scene) -> None:
    """NeRF's Blender scenes: a file per split, paths without suffix, alpha in the pictures."""
    for split in ("train", "test"):
        views = getattr(scene, split)
        for view in views:
            save_photo(folder / split / f"r_{view.name}.png", view)
        frames = [frame_of(view, f"./{split}/r_{view.name}", rotation=0.1) for view in views]
        save_json(folder / f"transforms_{split}.json", {"camera_angle_x": angle_x(views[0].camera), "frames": frames})


# ---------------------------------------------------------------- folders of one view each
def write_view_folder(folder: Path, view: View, photo: str) -> None:
    camera = view.camera
    matrix = ",".join(repr(float(value)) for value in camera.to_world.ravel())
    metadata = {"cam_transform_mat": matrix, "cam_angle_x": angle_x(camera), "imw": camera.width, "imh": camera.height, "spp": 128}
    save_json(folder / "metadata.json", {**metadata, "envmap": f"{TRAIN_LIGHT}.hdr", "envmap_inten": 3.0, "scene": "tiny"})
    save_photo(folder / photo, view)
    if view.albedo is not None:
        save_png(folder / "albedo.png", straight(view.albedo, view.mask), view.mask)
    if view.normal is not None:
        normal = straight(view.normal, view.mask)
        unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        save_png(folder / "normal.png", 0.5 * unit + 0.5, view.mask)


def relit_views(scene: Scene, view: View) -> list[View]:
    """The novel views of a test view's camera, under novel lights."""
    return [v for v in scene.novel if v.light != "train" and np.array_equal(v.camera.to_world, view.camera.to_world)]


def write_tensoir(folder: Path, scene: Scene) -> None:
    photo = f"rgba_{TRAIN_LIGHT}_000.png"
    for split in ("train", "test"):
        for number, view in enumerate(getattr(scene, split)):
            place = folder / f"{split}_{number:03}"
            write_view_folder(place, view, photo)
            save_photo(place / f"rgba_{TRAIN_LIGHT}_120.png", view)  # a turned light, which is no novel one
            for relit in relit_views(scene, view) if split == "test" else ():
                save_photo(place / f"rgba_{relit.light}.png", relit)
    for light in (TRAIN_LIGHT, *TINTS):
        save_hdr(folder.parent / "maps" / f"{light}.hdr", blender_map(LIGHTS[light]))


def write_nerfactor(folder: Path, scene: Scene) -> None:
    """Training light three times the file; two of the held-out views are validation views."""
    for split, views in (("train", scene.train), ("val", scene.test[:2]), ("test", scene.test[2:])):
        for number, view in enumerate(views):
            place = folder / f"{split}_{number:03}"
            write_view_folder(place, view, "rgba.png")
            for relit in relit_views(scene, view) if split != "train" else ():
                save_photo(place / f"rgba_{relit.light}.png", relit)
                save_photo(place / "rgba_olat-0000-0008.png", relit)
    for light in (TRAIN_LIGHT, *TINTS):
        save_hdr(folder.parent / "maps" / f"{light}.hdr", blender_map(LIGHTS[light]) / (3 if light == TRAIN_LIGHT else 1))


# ---------------------------------------------------------------- Synthetic4Relight
def write_synthetic4relight(folder: Path, scene: Scene) -> None:
    for split in ("train", "test"):
        views = getattr(scene, split)
        for number, view in enumerate(views):
            place = folder / split
            if split == "train":
                save_exr(place / f"{number:03}_rgb.exr", straight(view.image, view.mask))
                save_png(place / f"{number:03}_mask.png", view.mask)
                continue
            save_photo(place / f"{number:03}_rgba.png", view)
            if view.albedo is not None and view.roughness is not None:
                save_png(place / f"{number:03}_albedo.png", straight(view.albedo, view.mask), view.mask)
                rough = straight(view.roughness, view.mask)
                save_png(place / f"{number:03}_rough.png", np.stack([rough] * 3, -1), view.mask)
            for relit in relit_views(scene, view):
                save_photo(folder / "test_rli" / f"{relit.light}_{number:03}.png", relit)
        frames = [frame_of(view, f"./{split}/{number:03}") for number, view in enumerate(views)]
        save_json(folder / f"transforms_{split}.json", {"camera_angle_x": angle_x(views[0].camera), "frames": frames})
    for light in (TRAIN_LIGHT, *TINTS):
        save_exr(folder.parent / "maps" / f"{light}.exr", blender_map(LIGHTS[light]))


def with_maps(folder: Path) -> dict[str, Any]:
    return {"lights": str(folder.parent / "maps")}


LAYOUTS = (
    Layout("nerfstudio", write_nerfstudio, unlit),
    Layout("nerfstudio", write_blender, unlit),
    Layout("tensoir", write_tensoir, known=("albedo", "normal"), lights=True, options=with_maps),
    Layout("nerfactor", write_nerfactor, known=("albedo", "normal"), lights=True, options=with_maps),
    Layout(
        "synthetic4relight",
        write_synthetic4relight,
        known=("albedo", "roughness"),
        lights=True,
        options=lambda folder: {**with_maps(folder), "light": TRAIN_LIGHT},
        linear=("train",),
    ),
)
