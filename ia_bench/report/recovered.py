"""What a run recovered, read back from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any

import torch

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json, user_path
from ia_bench.material.textures import Material
from ia_bench.runs.config import ReaderConfig, content_of
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.metrics import METRICS
from ia_bench.scenes.exr import read_exr

SHOWN = ("aligned_albedo.psnr", "view_synthesis.psnr", "relighting.psnr", "roughness.mse")
"""The scores in titles and below pictures, by component and name; each may be undefined (None)."""

READER = {"name": str, "target": str, "options": dict}


@dataclass(frozen=True)
class Recovered:
    """What a run recovered, as tensors.

    Attributes:
        material: Its textures.
        light: Its lat-long map.
        scale: (3,), the factor that aligned the albedo in its scores.
        title: Words for a picture's title.
        bounces: Of the indirect light with which it rendered.
        coat: How its two lobes were coupled.
        scores: The metrics of metrics.json, by component and name.
    """

    material: Material
    light: torch.Tensor
    scale: torch.Tensor
    title: str
    bounces: int
    coat: str
    scores: dict[str, dict[str, float | None]]


def read_run(folder: Path, scene_folder: Path) -> tuple[Recovered, ReaderConfig]:
    """Read the run's maps, and which reader read its scene.

    Raises InputError for a run without results, of another scene than that in ``scene_folder``, or whose files lack a key.
    """
    metrics, config = (_Record(folder / name) for name in (METRICS, CONFIG))
    status = metrics.get("status", str)
    if status != "ok":
        raise InputError(f"{folder / METRICS}: expected a finished run, found status {status!r}")
    _check_scene(config, scene_folder)
    name = metrics.get("protocol_description.alignment", str)
    scales = metrics.get("albedo_scales", dict).get(name) or [1.0] * 3  # a run whose albedo cannot be aligned is shown as it is
    albedo, roughness = read_exr(folder / "albedo.exr", 3), read_exr(folder / "roughness.exr", 1)
    light = torch.from_numpy(read_exr(folder / "light.exr", 3))
    scores = {key: metrics.get(f"metrics.{key}", float | int | None) for key in SHOWN}
    values = {key.removesuffix(".psnr"): value for key, value in scores.items() if key.endswith(".psnr")}
    shown = [f"{key.replace('_', ' ')} {value:.1f} dB" for key, value in values.items() if value is not None]
    row, scene, seed = metrics.get("row", str), metrics.get("scene", str), metrics.get("seed", int)
    title = ", ".join([f"{row}, scene {scene}, seed {seed}", *shown])
    metal = folder / "metallic.exr"
    metallic = torch.from_numpy(read_exr(metal, 1)) if metal.is_file() else None
    material = Material(torch.from_numpy(albedo), torch.from_numpy(roughness), metallic)
    bounces = next((entry["value"] for entry in metrics.get("plan.needed", list) if entry["what"] == "render.bounces"), 0)
    coat = config.get("config.render", dict).get("coat", "added")  # older runs had direct light and the paper's sum
    scale = torch.tensor(scales)
    reader = ReaderConfig(*(config.get(f"config.reader.{key}", kind) for key, kind in READER.items()))
    return Recovered(material, light, scale, title, bounces, coat, metrics.get("metrics", dict)), reader


class _Record:
    """A JSON file of a run, whose values are asked for by their dotted keys."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._content = read_json(path)

    def get(self, key: str, kind: type | UnionType) -> Any:  # noqa: ANN401 (a value of that kind)
        """The value of ``key``. Raises InputError where there is none, or one of another kind."""
        value: Any = self._content
        for part in key.split("."):
            if not isinstance(value, dict) or part not in value:
                raise InputError(f"{self.path}: {key}: expected {_words(kind)}, found nothing")
            value = value[part]
        if not isinstance(value, kind):
            raise InputError(f"{self.path}: {key}: expected {_words(kind)}, found {value!r}")
        return value


def _words(kind: type | UnionType) -> str:
    return kind.__name__ if isinstance(kind, type) else str(kind)


def _check_scene(config: _Record, folder: Path) -> None:
    """A run's maps fit no other mesh, though they could be put on it: compare what decides the run's identity."""
    found = config.get("config.scene.content", str)
    expected = content_of(user_path("scene.path", str(folder), folder=True))
    if found != expected:
        raise InputError(
            f"{config.path}: config.scene.content: expected {expected[:8]}, the content of {folder}, found {found[:8]}: "
            f"the run was on another scene ({config.get('config.scene.name', str)}), or a file of the scene has changed since"
        )
