"""What a run recovered, read back from its folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ia_bench.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.records import CONFIG, METRICS
from ia_bench.scenes.exr import read_exr


@dataclass(frozen=True)
class Recovered:
    """A run's maps as tensors, and the words for its title; ``scale`` aligned the albedo in its scores.

    ``bounces`` and ``coat``: how it rendered them. ``scores``: the metrics of metrics.json by component and name.
    """

    material: Material
    light: torch.Tensor
    scale: float
    title: str
    bounces: int
    coat: str
    scores: dict[str, dict[str, float | None]]


def read_run(folder: Path) -> tuple[Recovered, str]:
    """The run's maps, and how the scene's mesh was unwrapped for it. Raises InputError for a run without results."""
    metrics, config = (_read_json(folder / name) for name in (METRICS, CONFIG))
    if metrics.get("status") != "ok":
        raise InputError(f"{folder / METRICS}: expected a finished run, found status {metrics.get('status')!r}")
    name = metrics["protocol_description"]["alignment"]
    scales = metrics["albedo_scales"].get(name) or [1.0]  # a run whose albedo cannot be aligned is shown as it is
    albedo, roughness = read_exr(folder / "albedo.exr", 3), read_exr(folder / "roughness.exr", 1)
    light = torch.from_numpy(read_exr(folder / "light.exr", 3))
    values = {key: metrics["metrics"][key]["psnr"] for key in ("aligned_albedo", "view_synthesis", "relighting")}
    shown = [f"{key.replace('_', ' ')} {value:.1f} dB" for key, value in values.items() if value is not None]
    title = ", ".join([f"{metrics['row']}, scene {metrics['scene']}, seed {metrics['seed']}", *shown])
    metal = folder / "metallic.exr"
    metallic = torch.from_numpy(read_exr(metal, 1)) if metal.is_file() else None
    material = Material(torch.from_numpy(albedo), torch.from_numpy(roughness), metallic)
    bounces = next((entry["value"] for entry in metrics["plan"]["needed"] if entry["what"] == "render.bounces"), 0)
    coat = config["config"]["render"].get("coat", "added")  # older runs had direct light and the paper's sum
    scale = float(np.mean(scales))
    return Recovered(material, light, scale, title, bounces, coat, metrics["metrics"]), config["config"]["geometry"]["uv"]


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: expected a run's results ({error})") from None
    return content
