"""Reader of the native scene folder (datasets/README.md): scene.json, mesh.ply, transforms_*.json, OpenEXR images."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.geometry.mesh import load_mesh
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import read_exr, refuse_negative
from ia_bench.scenes.scene import Camera, Scene, Truth, View

SPLITS = ("train", "test", "novel")
TRUTH_CHANNELS = {"albedo": 3, "roughness": 1, "specular": 3, "normal": 3, "depth": 1}


def load_scene(folder: Path, *, truth: bool = False, uv: str = "mesh") -> Scene:
    """Read a scene folder. With ``truth`` the ground truth of views, textures and lights comes along where it exists.

    ``uv`` as in :func:`ia_bench.geometry.mesh.load_mesh`. Raises InputError naming the file and the field at fault.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such scene folder")
    description = _read_json(folder / "scene.json")
    space = description.get("color_space")
    if space != "linear_rec709":
        raise InputError(f"{folder / 'scene.json'}: color_space: expected 'linear_rec709', found {space!r}")
    if description.get("up", "z") != "z":
        raise InputError(f"{folder / 'scene.json'}: up: expected 'z', found {description['up']!r}")
    mesh, notes = load_mesh(folder / "mesh.ply", uv=uv)
    views = {
        split: _read_split(folder, split, truth) if (folder / f"transforms_{split}.json").is_file() else ()
        for split in SPLITS
    }
    if not views["train"]:
        raise InputError(f"{folder / 'transforms_train.json'}: a scene needs at least one training view")
    for name in ("image", "specular"):
        views, notes = _without_ringing(views, name, notes)
    return Scene(
        name=str(description.get("name", folder.name)),
        folder=folder,
        mesh=mesh,
        truth=_read_truth(folder, description) if truth else None,
        notes=notes,
        metallic=_metallic(folder, description),
        **views,
    )


def _metallic(folder: Path, description: dict[str, Any]) -> bool:
    metallic = description.get("metallic", False)
    if not isinstance(metallic, bool):
        raise InputError(f"{folder / 'scene.json'}: metallic: expected true or false, found {metallic!r}")
    return metallic


def _without_ringing(
    views: dict[str, tuple[View, ...]], name: str, notes: tuple[str, ...]
) -> tuple[dict[str, tuple[View, ...]], tuple[str, ...]]:
    """Radiance ``name`` of all views without what lossy compression leaves below zero and beyond the object; says so."""
    count = 0
    cleaned: dict[str, tuple[View, ...]] = {}
    for split, found in views.items():
        kept = []
        for view in found:
            radiance = getattr(view, name)
            if radiance is not None:
                wrong = (radiance < 0) | ((radiance != 0) & (view.mask == 0)[..., None])
                count += int(wrong.sum())
                cleared: dict[str, Any] = {name: np.where(wrong, 0, radiance)}
                view = replace(view, **cleared)
            kept.append(view)
        cleaned[split] = tuple(kept)
    if not count:
        return views, notes
    what = {"image": "images", "specular": "true specular shading"}[name]
    line = f"{what}: {count} values below zero or beyond the object (ringing of lossy compression) set to 0"
    return cleaned, (*notes, line)


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(content).__name__}")
    return content


def _read_split(folder: Path, split: str, truth: bool) -> tuple[View, ...]:
    path = folder / f"transforms_{split}.json"
    transforms = _read_json(path)
    frames = transforms.get("frames")
    if not isinstance(frames, list):
        raise InputError(f"{path}: frames: expected a list, found {type(frames).__name__}")
    views: list[View] = []
    for i, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise InputError(f"{path}: frames[{i}]: expected an object, found {type(frame).__name__}")
        views.append(_read_view(folder, path, i, {**transforms, **frame}, truth))
        size, first = views[-1].mask.shape, views[0].mask.shape
        if size != first:
            raise InputError(
                f"{folder / frame['file_path']}: expected {first[0]} x {first[1]} pixels like the split's first image, "
                f"found {size[0]} x {size[1]}"
            )
    return tuple(views)


def _read_view(folder: Path, source: Path, index: int, frame: dict[str, Any], truth: bool) -> View:
    where = f"{source}: frames[{index}]"
    if not isinstance(frame.get("file_path"), str):
        raise InputError(f"{where}: file_path: expected the path of an image, found {frame.get('file_path')!r}")
    image = read_exr(folder / frame["file_path"], 4)
    height, width = image.shape[:2]
    for key, size in (("w", width), ("h", height)):
        if key in frame and _number(where, frame, key) != size:
            raise InputError(f"{folder / frame['file_path']}: expected {key} = {frame[key]}, found {size}")
    mask = image[..., 3]
    if mask.min() < 0 or mask.max() > 1 + 1e-3:
        found = f"{mask.min():g} ... {mask.max():g}"
        raise InputError(f"{folder / frame['file_path']}: alpha: expected values in [0, 1], found {found}")
    if not (mask > 0.5).any():
        raise InputError(f"{folder / frame['file_path']}: the mask (alpha) has no pixel above 0.5")
    radiance = image[..., :3]
    refuse_negative(folder / frame["file_path"], radiance)
    known: dict[str, np.ndarray] = {}
    for name, channels in TRUTH_CHANNELS.items():
        if truth and f"{name}_path" in frame:
            values = read_exr(folder / frame[f"{name}_path"], channels)
            if values.shape[:2] != (height, width):
                raise InputError(
                    f"{folder / frame[f'{name}_path']}: expected {height} x {width} pixels like its image, "
                    f"found {values.shape[0]} x {values.shape[1]}"
                )
            known[name] = values[..., 0] if channels == 1 else values
    return View(
        name=Path(frame["file_path"]).with_suffix("").name,
        camera=_read_camera(where, frame, width, height),
        image=np.ascontiguousarray(radiance),
        mask=mask.clip(0, 1),
        light=str(frame.get("light", "train")),
        **known,
    )


def _read_camera(where: str, frame: dict[str, Any], width: int, height: int) -> Camera:
    try:
        to_world = np.asarray(frame.get("transform_matrix"), np.float64)
    except (TypeError, ValueError):
        to_world = np.zeros(0)
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all():
        raise InputError(f"{where}: transform_matrix: expected 4 x 4 finite numbers, found shape {to_world.shape}")
    rotation = to_world[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if np.abs(to_world[3] - (0, 0, 0, 1)).max() > 1e-6:  # a transposed matrix holds a rotation too
        raise InputError(f"{where}: transform_matrix: expected the last row 0 0 0 1, found {to_world[3].tolist()}")
    if error > 1e-3 or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{where}: transform_matrix: expected a rotation (R R^T = 1, det = +1), "
            f"found |R R^T - 1| = {error:.3g}, det = {np.linalg.det(rotation):.3g}"
        )
    if "fl_x" in frame:
        focal = _number(where, frame, "fl_x"), _number(where, frame, "fl_y" if "fl_y" in frame else "fl_x")
        if min(focal) <= 0:
            raise InputError(f"{where}: fl_x, fl_y: expected a positive focal length, found {focal}")
    elif "camera_angle_x" in frame:
        angle = _number(where, frame, "camera_angle_x")
        if not 0 < angle < math.pi:
            raise InputError(f"{where}: camera_angle_x: expected radians between 0 and pi, found {angle:g}")
        focal = (0.5 * width / math.tan(0.5 * angle),) * 2
    else:
        raise InputError(f"{where}: expected camera_angle_x or fl_x, found neither")
    centre = (
        _number(where, frame, "cx") if "cx" in frame else 0.5 * width,
        _number(where, frame, "cy") if "cy" in frame else 0.5 * height,
    )
    return Camera(to_world=to_world, focal=focal, centre=centre, width=width, height=height)


def _number(where: str, frame: dict[str, Any], key: str) -> float:
    value = frame[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key}: expected a finite number, found {value!r}")
    return float(value)


def _read_truth(folder: Path, description: dict[str, Any]) -> Truth:
    for key in ("lights", "truth_textures"):
        if not isinstance(description.get(key, {}), dict):
            raise InputError(f"{folder / 'scene.json'}: {key}: expected an object, found {description[key]!r}")
    lights = {name: read_exr(folder / path, 3) for name, path in description.get("lights", {}).items()}
    textures = description.get("truth_textures", {})
    albedo = srgb_to_linear(_read_png(folder / textures["albedo"], "RGB")) if "albedo" in textures else None
    roughness = _read_png(folder / textures["roughness"], "L") if "roughness" in textures else None
    return Truth(lights=lights, albedo=albedo, roughness=roughness)


def _read_png(path: Path, mode: str) -> np.ndarray:
    if not path.is_file():
        raise InputError(f"{path}: no such texture")
    with Image.open(path) as image:
        return np.asarray(image.convert(mode), np.float32) / 255.0
