"""Names and metadata of a scene folder: which files a view consists of, transforms and scene.json."""

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cameras import FIELD_OF_VIEW, split_poses
from exr import STORAGE
from latlong import CONVENTION
from numpy.typing import NDArray
from recipe import Recipe

TRUTH = {
    "train": ("specular",),  # albedo follows exactly from the texture
    "test": ("albedo", "specular", "roughness", "normal", "depth"),
    "novel": (),
    "direct": (),
}
"""Ground truth images of each split, all under the training light."""

DIRECT_VIEWS = 4
"""Test views, evenly spaced, of which an image with direct light only is kept: the split "direct"."""


@dataclass(frozen=True)
class View:
    """One image to render: camera `index` of a split under a light."""

    split: str
    index: int
    light: str
    pose: NDArray[np.float64]
    metal: bool = False

    @property
    def image(self) -> str:
        """Path of the image in the scene folder."""
        folder = {"novel": f"images/novel/{self.light}", "direct": "direct/test"}.get(self.split, f"images/{self.split}")
        return f"{folder}/{self.index:04d}.exr"

    @property
    def truth(self) -> dict[str, str]:
        """Paths of the ground truth images by kind."""
        kinds = (*TRUTH[self.split], *(["metallic"] if self.metal and self.split == "test" else []))
        return {kind: f"truth/{self.split}/{kind}/{self.index:04d}.exr" for kind in kinds}

    @property
    def files(self) -> list[str]:
        """Paths of all files that rendering this view writes."""
        return [self.image, *self.truth.values()]


def views(recipe: Recipe) -> list[View]:
    """Every view of a scene, in the order in which they are rendered."""
    return list(_views(recipe))


def _views(recipe: Recipe) -> Iterator[View]:
    for split, count in recipe.views.items():
        poses = split_poses(split, count)
        for light in recipe.lights if split == "novel" else ("train",):
            for index, pose in enumerate(poses):
                yield View(split, index, light, pose, recipe.metal)
    poses = split_poses("test", recipe.views["test"])
    for index in range(0, len(poses), max(1, len(poses) // DIRECT_VIEWS))[:DIRECT_VIEWS]:
        yield View("direct", index, "train", poses[index])


def write_transforms(out: Path, recipe: Recipe) -> None:
    """Write transforms_{train,test,novel}.json."""
    for split in recipe.views:
        frames = []
        for view in (v for v in _views(recipe) if v.split == split):
            frame: dict[str, Any] = {"file_path": view.image}
            if split == "novel":
                frame["light"] = view.light
            frame["transform_matrix"] = view.pose.round(8).tolist()
            frame |= {f"{kind}_path": path for kind, path in view.truth.items()}
            frames.append(frame)
        data = {"camera_angle_x": FIELD_OF_VIEW, "w": recipe.size, "h": recipe.size, "frames": frames}
        write_json(out / f"transforms_{split}.json", data)


def write_scene(out: Path, name: str, recipe: Recipe, render: dict[str, Any]) -> None:
    """Write scene.json; `render` says how the images were made."""
    textures = ("roughness", "metallic") if recipe.metal else ("roughness",)
    scene = {
        "schema": 1,
        "name": name,
        "up": "z",
        "color_space": "linear_rec709",
        "light_convention": CONVENTION,
        "splits": recipe.views,
        "lights": {light: f"lights/{light}.exr" for light in recipe.lights},
        **({"metallic": True} if recipe.metal else {}),
        "truth_textures": {"albedo": "truth/albedo.webp"} | {name: f"truth/{name}.png" for name in textures},
        "render": render | {"storage": {kind: asdict(storage) for kind, storage in STORAGE.items()}},
    }
    write_json(out / "scene.json", scene)


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON atomically, one line per key and per item of a list of objects: readable, and small."""
    lines = []
    for key, value in data.items():
        text = json.dumps(value)
        if isinstance(value, list) and value and isinstance(value[0], dict):
            text = "[\n  " + ",\n  ".join(json.dumps(item) for item in value) + "\n]"
        lines.append(f"{json.dumps(key)}: {text}")
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    temporary.replace(path)


def byte_totals(out: Path) -> dict[str, int]:
    """Bytes per kind of file in a scene folder, largest first."""
    totals: dict[str, int] = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        parts = path.relative_to(out).parts
        kind = "/".join(parts[:-1]) if len(parts) > 1 else parts[0]
        totals[kind] = totals.get(kind, 0) + path.stat().st_size
    return dict(sorted(totals.items(), key=lambda item: -item[1]))
