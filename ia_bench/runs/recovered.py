"""What a run recovered, read back from its folder: for pictures, benchmarks, and scores under another protocol."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np
import torch

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json, user_path
from ia_bench.common.settings import parsed
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.runs.config import ReaderConfig, SceneConfig, resolve_scene_folder
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.identity import CONSISTENCY_KEY, HASHED, content_of
from ia_bench.runs.record import METRICS_FILE, RunRecord
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.scene import Scene
from ia_bench.scores.result import drawn_scale

READER = {"name": str, "target": str, "options": dict}


class RecordFile:
    """A JSON file of a run, whose values are asked for by their dotted keys."""

    def __init__(self, path: Path) -> None:
        """Raises InputError for what is no JSON object."""
        self.path, self.content = path, read_json(path)

    def get(self, key: str, kind: type | UnionType) -> Any:  # noqa: ANN401 (a value of that kind)
        """The value of ``key``. Raises InputError where there is none, or one of another kind."""
        value: Any = self.content
        words = kind.__name__ if isinstance(kind, type) else str(kind)
        for part in key.split("."):
            if not isinstance(value, Mapping) or part not in value:
                raise InputError(f"{self.path}: {key}: expected {words}, found nothing")
            value = value[part]
        if not isinstance(value, kind):
            raise InputError(f"{self.path}: {key}: expected {words}, found {value!r}")
        return value


class Recovered:
    """A finished run, also one that an older state of the code has left.

    Attributes:
        folder: The run's folder.
        record: Its metrics.json.
        config: Its config.json.
        reader: Which reader read its scene.
        scale: (3,), what aligned the albedo of its textures in its scores; ones where it cannot be aligned.
    """

    def __init__(self, folder: Path) -> None:
        """Raises InputError for a run without results, or whose files lack a key."""
        try:
            self.record = RunRecord.read(folder)
        except FileNotFoundError as error:
            raise InputError(f"{folder}: expected a run's {METRICS_FILE}, found none") from error
        self.folder, self.config = folder, RecordFile(folder / CONFIG)
        if self.record.status != "ok":
            raise InputError(f"{folder / METRICS_FILE}: expected a finished run, found status {self.record.status!r}")
        alignment = str(self.record.protocol_description.get("alignment"))
        self.scale = torch.tensor(drawn_scale(self.record.albedo_scales, alignment) or [1.0] * 3)
        if "geometry" in self.config.get("config", dict):  # before there were readers, there was one
            self.reader = ReaderConfig(options={"uv": self.config.get("config.geometry.uv", str)})
        else:
            self.reader = ReaderConfig(*(self.config.get(f"config.reader.{key}", kind) for key, kind in READER.items()))

    @property
    def given(self) -> dict[str, str]:
        """What :func:`ia_bench.runs.identity.given` kept; nothing in the oldest runs."""
        found: dict[str, str] = self.config.content.get("given", {})
        return found

    def score(self, key: str) -> float | None:
        """A metric by its dotted name, None where it is undefined."""
        return self.record.score(key)

    @property
    def capture(self) -> CaptureSettings:
        """How its scene was photographed. Raises InputError for what is no setting of a capture."""
        kept = self._with_paths("capture", self.config.get("config", dict).get("capture", {}))
        name = {"name": self.given["capture.name"]} if "capture.name" in self.given else {}
        return parsed(CaptureSettings, {key: value for key, value in kept.items() if key != CONSISTENCY_KEY} | name, "capture")

    def check_scene(self, folder: Path) -> None:
        """Raise InputError unless the scene in ``folder`` is the run's, to the byte: maps fit no other mesh."""
        found = self.config.get("config.scene.content", str)
        expected = content_of(user_path("scene.path", str(folder), folder=True))
        if found != expected:
            name = self.config.get("config.scene.name", str)
            raise InputError(
                f"{self.config.path}: config.scene.content: expected {expected[:8]}, the content of {folder}, found {found[:8]}: "
                f"the run was on another scene ({name}), or a file of the scene has changed since"
            )

    def read_scene(self, folder: Path | None = None, *, whole: bool = False) -> Scene:
        """The run's scene with its truth, as it was captured, or ``whole``: in ``folder``, or where the run found it.

        Raises InputError as :meth:`check_scene`, and for another file of the reader's that is gone or has changed since.
        """
        path = self.given.get("scene.path") if folder is None else str(folder)
        scene = SceneConfig(self.config.get("config.scene.name", str), path)
        place = resolve_scene_folder(scene, self.reader)
        if place is not None:
            self.check_scene(place)
        reader = replace(self.reader, options=self._with_paths("reader.options", self.reader.options))
        found = read_scene(scene, reader, truth=True)
        return found if whole else captured(found, self.capture, lambda line: None)

    def reconstruction(self, stage: Stage) -> TexturedReconstruction:
        """What the run recovered, on a stage of its scene's mesh; some methods recover no light of the whole scene.

        Raises InputError where a texture is missing.
        """

        def texture(name: str, channels: int) -> torch.Tensor:
            image: np.ndarray = read_exr(self.folder / f"{name}.exr", channels)
            return torch.from_numpy(image).to(stage.device)

        def optional(name: str, channels: int) -> torch.Tensor | None:
            return texture(name, channels) if (self.folder / f"{name}.exr").is_file() else None

        material = Material(texture("albedo", 3), texture("roughness", 1), optional("metallic", 1))
        coat = self.config.get("config.render", dict).get("coat", "added")  # the oldest runs had the paper's sum
        return TexturedReconstruction(stage, material, optional("light", 3), coat=coat)

    def _with_paths(self, key: str, value: Any) -> Any:  # noqa: ANN401 (a setting, whatever it is)
        """``value``, part of the configuration, with the paths that the run was given in place of their hashes.

        Raises InputError for one that nobody kept, or whose content is another now.
        """
        if isinstance(value, Mapping):
            return {name: self._with_paths(f"{key}.{name}", part) for name, part in value.items()}
        if isinstance(value, list):
            return [self._with_paths(f"{key}.{place}", part) for place, part in enumerate(value)]
        if not isinstance(value, str) or not value.startswith(HASHED):
            return value
        path = self.given.get(key)
        if path is None:
            raise InputError(f"{self.config.path}: config.{key}: expected the path of what the run read, found its hash alone")
        if not Path(path).exists() or HASHED + content_of(Path(path)) != value:
            raise InputError(f"{self.config.path}: given.{key}: expected {path} as the run read it, found it gone or changed")
        return path
