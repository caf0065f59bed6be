"""Reader of the native scene folder (datasets/README.md): scene.json, mesh.ply, transforms_*.json, OpenEXR images."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import file_below, is_file, read_json, shown
from ia_bench.geometry.mesh import load_mesh
from ia_bench.readers.cameras import (
    NamedFrame,
    camera,
    expect_each_once,
    expect_size_of,
    frames_if_there,
    frames_of,
    photographs,
    text,
)
from ia_bench.readers.contract import SPLITS, TRUTH_OF_VIEWS
from ia_bench.readers.lenses import Lens, lens
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import expect_radiance, read_exr, read_light
from ia_bench.scenes.photograph import expect_size, greyscale, open_picture, picture_values, unit_alpha
from ia_bench.scenes.scene import Mesh, Scene, Truth, View

DESCRIPTION = "scene.json"
MESH = "mesh.ply"
SHARED_LIGHTS = "lights"
"""Name of the folder, beside that of the scenes, with lights that several scenes see and that are stored once."""
CHECKED = {"metallic": bool, "splits": dict, "lights": dict, "truth_textures": dict}
"""The kinds of values of the description, a dict being an object of JSON."""
OTHERS = {"nerfstudio": "transforms*.json", "dtu": "cameras*.npz", "llff": "poses_bounds.npy", "colmap": "sparse"}
"""Readers of formats whose folders are told by a file in them."""
RINGING = {"image": "images", "specular": "true specular shading"}
RANG = "values below zero or beyond the object (ringing of lossy compression) set to 0"


class NativeReader:
    """Reads the native scene folder ``path``.

    ``uv``: "mesh" uses the texture coordinates of mesh.ply, "xatlas" makes new ones (:func:`ia_bench.geometry.mesh.load_mesh`).
    """

    def __init__(self, path: Path | None, *, uv: Literal["mesh", "xatlas"] = "mesh") -> None:
        if path is None:
            raise InputError("reader=native: expected scene.path=FOLDER, found none")
        self._folder, self._uv = path, uv

    def read(self, truth: bool) -> Scene:
        """The scene; its ground truth, as far as there is any, only with ``truth``. Raises InputError naming file and field."""
        folder = self._folder
        if not folder.is_dir():
            raise InputError(f"{folder}: no such scene folder")
        if not is_file(folder / DESCRIPTION):
            likely = next((name for name, file in OTHERS.items() if any(folder.glob(file))), None)
            other = "reader=NAME reads other formats (ia-bench run --choices)" if likely is None else f"reader={likely} may read it"
            raise InputError(f"{folder / DESCRIPTION}: no such file, as reader=native wants it; {other}")
        description = read_json(folder / DESCRIPTION)
        for key, kind in CHECKED.items():
            unsaid = key == "metallic" and description.get(key, False) is None  # nobody knows, as of captures that were written so
            if key in description and not unsaid and not isinstance(description[key], kind):
                raise InputError(f"{folder / DESCRIPTION}: {key}: expected {kind.__name__}, found {description[key]!r}")
        for key, expected, default in (("schema", 1, 1), ("color_space", "linear_rec709", None), ("up", "z", "z")):
            if (found := description.get(key, default)) != expected:
                raise InputError(f"{folder / DESCRIPTION}: {key}: expected {expected!r}, found {found!r}")
        mesh: Mesh | None = None
        notes: tuple[str, ...] = (f"no {MESH} in the scene's folder",)
        if os.path.lexists(folder / MESH):  # a link that leads nowhere is a mistake, not a scene without a mesh
            mesh, notes = load_mesh(path := file_below(folder, MESH, str(folder)), uv=self._uv)
        rung = Counter[str]()
        frames = {split: self._frames(split) for split in SPLITS}
        for split in ("test", "novel"):  # which may name the same ones
            expect_each_once(photographs([*frames["train"], *frames[split]]))
        views = {
            split: tuple(_without_ringing(self._view(*frame, truth), rung) for frame in named) for split, named in frames.items()
        }
        if not views["train"]:
            raise InputError(f"{folder / 'transforms_train.json'}: a scene needs at least one training view")
        for split, count in description.get("splits", {}).items():
            there = views.get(split, ())
            cameras = len({view.camera.to_world.tobytes() for view in there})  # each may see the object under several lights
            if count not in (len(there), cameras):
                raise InputError(f"{folder / DESCRIPTION}: splits: expected {count!r} {split} views, found {len(there)}")
        notes += tuple(f"{RINGING[name]}: {count} {RANG}" for name, count in sorted(rung.items()) if count)
        known = self._truth(description) if truth else None
        if known is not None and mesh is not None and self._uv == "xatlas" and description.get("truth_textures"):
            try:
                known = replace(known, mesh=load_mesh(path)[0])  # whose coordinates are those of the true textures
            except InputError:
                known = Truth(known.lights)
                notes += (f"true textures are left out: {MESH} has no coordinates for them",)
        return Scene(
            name=text(str(folder / DESCRIPTION), description, "name", folder.name),
            source=str(folder),
            mesh=mesh,
            truth=known,
            notes=notes,
            metallic=description.get("metallic", False),
            train=views["train"],
            test=views["test"],
            novel=views["novel"],
        )

    def _frames(self, split: str) -> list[NamedFrame]:
        path = self._folder / f"transforms_{split}.json"
        return frames_of(path) if split == "train" else frames_if_there(path)

    def _view(self, where: str, frame: Mapping[str, Any], truth: bool) -> View:
        path = file_below(self._folder, frame.get("file_path"), f"{where}: file_path")
        if lens(where, frame) != Lens():
            raise InputError(f"{where}: expected a pinhole camera without distortion, found a lens; reader=nerfstudio undoes one")
        image = read_exr(path, 4)
        expect_size_of(where, frame, path, image.shape)
        radiance, mask = image[..., :3], unit_alpha(path, image[..., 3])
        expect_radiance(path, radiance)
        known: dict[str, Any] = {}
        for name, (channels, _, _) in TRUTH_OF_VIEWS.items():
            if truth and f"{name}_path" in frame:
                file = file_below(self._folder, frame[f"{name}_path"], f"{where}: {name}_path")
                values = read_exr(file, channels)
                expect_size(file, values.shape, image.shape, "its image")
                known[name] = values[..., 0] if channels == 1 else values
        return View(
            name=path.stem,
            camera=camera(where, frame, image.shape),
            image=np.ascontiguousarray(radiance),
            mask=mask,
            light=text(where, frame, "light", "train"),
            **known,
        )

    def _truth(self, description: Mapping[str, Any]) -> Truth:
        def listed(key: str, find: Callable[[Path, Any, str], Path]) -> dict[str, Path]:
            where = f"{self._folder / DESCRIPTION}: {key}"
            return {name: find(self._folder, value, f"{where}.{name}") for name, value in description.get(key, {}).items()}

        textures = {name: (path, open_picture(path)) for name, path in listed("truth_textures", file_below).items()}
        albedo = srgb_to_linear(picture_values(*textures["albedo"])[..., :3]) if "albedo" in textures else None
        roughness, metallic = (greyscale(*textures[name]) if name in textures else None for name in ("roughness", "metallic"))
        return Truth({name: read_light(path) for name, path in listed("lights", _light).items()}, albedo, roughness, metallic)


def _light(folder: Path, value: object, where: str) -> Path:
    """The file of a light: a path below ``folder``, or {"shared": name, "sha256": its hash}, a file of SHARED_LIGHTS.

    The hash is what makes a shared light a part of the scene's folder, by whose content a run is known.
    """
    if not isinstance(value, dict):
        return file_below(folder, value, where)
    if set(value) != {"shared", "sha256"}:
        raise InputError(f"{where}: expected a path, or an object with shared and sha256, found {shown(repr(value))}")
    home = folder.resolve().parent.parent / SHARED_LIGHTS
    path = file_below(home, value["shared"], f"{where}.shared: in {home}")
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != value["sha256"]:
        raise InputError(f"{path}: expected the light whose SHA-256 {where}.sha256 tells, {value['sha256']!r}, found {found!r}")
    return path


def _without_ringing(view: View, rung: Counter[str]) -> View:
    """The view, cleared in place of what lossy compression leaves below zero and beyond the object; ``rung`` counts the values."""
    for name in RINGING:
        radiance = getattr(view, name)
        if radiance is not None:
            wrong = (radiance < 0) | ((radiance != 0) & (view.mask == 0)[..., None])
            rung[name] += int(wrong.sum())
            radiance[wrong] = 0
    return view
