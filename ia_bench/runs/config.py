"""What one run is made of, checked by name and type, and the hash that is its identity."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.files import shown, user_path
from ia_bench.common.paths import PACKAGE, scenes_folder
from ia_bench.common.suggestions import unknown
from ia_bench.methods.two_stage.settings import (
    FIT_CHOICES,
    KINDS,
    FitSettings,
    SupervisionSettings,
    check_fit,
    check_supervision,
)
from ia_bench.render.settings import RenderSettings
from ia_bench.scores.protocol import Protocol

IDENTITY_VERSION = 3
"""Part of every hash; raised when a change of the code changes the numbers of an unchanged configuration."""

PACKAGED_WEIGHTS = PACKAGE / "priors" / "weights"
NATIVE_READER = "ia_bench.readers.native:NativeReader"

CHOICES: dict[str, tuple[str, ...]] = {
    "render.shadows": ("auto", "traced", "none"),
    "render.coat": ("layered", "added"),
    "render.shading": ("auto", "compiled", "eager"),
    **{f"fit.{key}": choices for key, choices in FIT_CHOICES.items()},
    "prior.supervision.kind": KINDS,
    "device": ("auto", "cpu", "cuda"),
}
"""Settings that are one of a few words."""

NUMBER_OR_AUTO = ("render.subsamples", "render.texture", "render.light_height")


@dataclass
class SceneConfig:
    """A scene: ``path`` is the folder that the reader is given, None for the shipped scene ``name``."""

    name: str = MISSING
    path: str | None = None


@dataclass
class ReaderConfig:
    """A reader of scenes: the class ``target`` (``"module:Class"``) called with the scene's folder and ``options``."""

    name: str = "native"
    target: str = NATIVE_READER
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class PriorConfig:
    """A prior: the class ``target`` (``"module:Class"``) called with ``options``, and how it supervises the fit."""

    name: str = MISSING
    target: str = MISSING
    options: dict[str, Any] = field(default_factory=dict)
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)


@dataclass
class MethodConfig:
    """A method that reconstructs: the class ``target`` (``"module:Class"``) called with ``options``."""

    name: str = MISSING
    target: str = MISSING
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class RunConfig:
    """One cell of a table. ``conf/config.yaml`` composes it; every field can be overridden on the command line.

    ``device``: "auto", "cpu" or "cuda". ``threads``: CPU threads, None for all that this process may use. ``row``: its
    label in tables, None for the prior's or method's name. ``out``: its folder, None for ``runs/<scene>/<row>-<hash>``.
    """

    scene: SceneConfig = field(default_factory=SceneConfig)
    reader: ReaderConfig = field(default_factory=ReaderConfig)
    prior: PriorConfig = field(default_factory=PriorConfig)
    method: MethodConfig = field(default_factory=MethodConfig)
    preset: str = MISSING
    render: RenderSettings = field(default_factory=RenderSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    protocol: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    device: str = "auto"
    threads: int | None = None
    row: str | None = None
    out: str | None = None

    @property
    def row_name(self) -> str:
        """Label in tables and folder names: ``row``, or what distinguishes this run (its prior, else its method)."""
        if self.row is not None:
            return self.row
        return self.prior.name if self.method.name == "two_stage" else self.method.name


def resolved(config: RunConfig) -> RunConfig:
    """The same run with everything filled in that depends on this machine: device, threads, the scene's name.

    Raises InputError for a value that its setting cannot take.
    """
    for key, choices in CHOICES.items():
        value = attrgetter(key)(config)
        if value not in choices:
            raise InputError(unknown(f"value of {key}", str(value), choices))
    for key in NUMBER_OR_AUTO:
        value = attrgetter(key)(config)
        if value != "auto" and not (isinstance(value, int) and value > 0):
            raise InputError(f"{key}: expected a positive whole number or auto, found {value}")
    bounces = config.render.bounces
    if bounces != "auto" and not (isinstance(bounces, int) and bounces >= 0):
        raise InputError(f"render.bounces: expected a whole number >= 0 or auto, found {bounces}")
    if config.render.metallic not in (True, False, "auto"):
        raise InputError(f"render.metallic: expected true, false or auto, found {config.render.metallic}")
    if config.render.samples < 1:
        raise InputError(f"render.samples: expected at least 1, found {config.render.samples}")
    check_fit(config.fit)
    check_supervision(config.prior.supervision)
    if config.threads is not None and config.threads < 1:
        raise InputError(f"threads: expected at least 1, found {config.threads}")
    if not 0 <= config.seed < 2**63:
        raise InputError(f"seed: expected 0 to 2^63 - 1, found {config.seed}")
    _check_options(config.prior.options)
    _check_finite("method.options", config.method.options)
    _check_finite("reader.options", config.reader.options)
    try:
        Protocol.from_config(config.protocol)
    except ValueError as error:
        raise InputError(str(error)) from None
    scene = config.scene
    if scene.path is not None:
        folder = user_path("scene.path", scene.path, folder=True)
        scene = replace(scene, name=folder.name, path=str(folder))
    elif config.reader.target != NATIVE_READER:  # which reads something else than the shipped scene of that name
        scene = replace(scene, name=config.reader.name)
    threads = config.threads or len(os.sched_getaffinity(0))
    return replace(config, scene=scene, threads=threads, device=_device(config.device))


def _check_options(options: dict[str, Any]) -> None:
    """Raise InputError for what no prior can take: NaN or infinity, or options of another prior that are no table."""
    nested = options.get("of_options") or {}
    if not isinstance(nested, Mapping):
        raise InputError(f"prior.options.of_options: expected a table of options, found {nested!r}")
    _check_finite("prior.options", options)


def _check_finite(key: str, value: Any) -> None:  # noqa: ANN401 (an option, whatever it is)
    """Raise InputError, naming the key, for NaN or infinity anywhere in a table of options."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            _check_finite(f"{key}.{name}", part)
    elif isinstance(value, (list, tuple)):
        for place, part in enumerate(value):
            _check_finite(f"{key}[{place}]", part)
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key}: expected a finite number, found {value}")


def resolve_scene_folder(scene: SceneConfig, reader: ReaderConfig | None = None) -> Path | None:
    """Folder of the scene's files, None for another ``reader`` than the native one that was given no ``scene.path``.

    Raises InputError naming the closest scene, or the two ways to say where scenes are.
    """
    if scene.path is not None:
        return user_path("scene.path", scene.path, folder=True)
    if reader is not None and reader.target != NATIVE_READER:
        return None
    root = scenes_folder()
    if not (root / scene.name).is_dir():
        raise InputError(unknown(f"scene in {root}:", scene.name, sorted(p.name for p in root.iterdir() if p.is_dir())))
    return root / scene.name


def identity(config: RunConfig) -> dict[str, Any]:
    """Everything that decides the numbers of a resolved run, as JSON types.

    Left out: where results go, the row's label, the preset's name (its values are in), how often checkpoints are
    written, whether samples are kept, and where files lie. Instead of the path of the scene, or of a prior's weights, there
    is a hash of the content; the weights of the package count for every prior that takes some. Priors, methods and readers of
    other distributions, or of the command line, count with their code (:func:`ia_bench.common.registry.foreign_code`).
    """
    content = asdict(config)
    for label in ("out", "row", "preset"):
        del content[label]
    del content["fit"]["checkpoint_seconds"]
    del content["prior"]["supervision"]["cache"]
    content["prior"]["options"] = {key: _without_paths(key, value) for key, value in config.prior.options.items()}
    options = config.prior.options
    weights = (options.get("of_options") or {}).get("weights") if "of_options" in options else options.get("weights", "none")
    if weights is None:
        content["prior"]["packaged_weights"] = content_of(PACKAGED_WEIGHTS)
    foreign = {
        "prior": registry.foreign_code("prior", config.prior.name, config.prior.target),
        "prior.options.of": registry.foreign_code("prior", options["of"]) if isinstance(options.get("of"), str) else None,
        "method": registry.foreign_code("method", config.method.name, config.method.target),
        "reader": registry.foreign_code("reader", config.reader.name, config.reader.target),
    }
    if any(foreign.values()):
        content["foreign_code"] = {key: code for key, code in foreign.items() if code is not None}
    content["reader"]["options"] = {key: _without_paths(key, value) for key, value in config.reader.options.items()}
    folder = resolve_scene_folder(config.scene, config.reader)
    content["scene"] = {"name": config.scene.name, "content": None if folder is None else content_of(folder)}
    protocol = Protocol.from_config(config.protocol).describe()
    protocol["lpips"]["weights"] = _without_paths("weights", protocol["lpips"]["weights"])
    content["protocol"] = protocol
    content["identity_version"] = IDENTITY_VERSION
    return content


def config_hash(config: RunConfig) -> str:
    """The run's identity: SHA-256 (hex) over the canonical JSON of :func:`identity`."""
    return hash_of(identity(config))


def hash_of(content: dict[str, Any]) -> str:
    """SHA-256 (hex) over canonical JSON: sorted keys, no spaces."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def labels(config: RunConfig) -> dict[str, Any]:
    """What names a run in its metrics: row, scene, seed and the protocol's label."""
    protocol = Protocol.from_config(config.protocol).label
    return {"row": config.row_name, "scene": config.scene.name, "seed": config.seed, "protocol": protocol}


def slug(text: str) -> str:
    """A label as a folder name: ``oracle w/o guided`` becomes ``oracle-w-o-guided``."""
    return "-".join("".join(c if c.isalnum() or c in "_." else " " for c in text).split())


def run_folder(config: RunConfig) -> Path:
    """Where a resolved run leaves its results: ``out``, or ``runs/<scene>/<row>-<hash>`` below the current folder.

    Raises InputError for a place in the scene's folder, whose content is part of a run's identity.
    """
    if config.out is not None:
        folder = Path(config.out).expanduser()
    else:
        folder = Path("runs", slug(config.scene.name), f"{slug(config.row_name)}-{config_hash(config)[:8]}")
    scene = resolve_scene_folder(config.scene, config.reader)
    if scene is not None and Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(scene)):
        raise InputError(f"out={folder}: expected a folder outside of the scene's, found one in {scene}")
    return folder


def _device(wanted: str) -> str:
    if wanted == "cpu":
        return wanted
    import torch  # takes a second or two; a run on the CPU by choice can be told apart without it

    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise InputError("device=cuda: torch finds no CUDA device here; use device=cpu or device=auto")
    return "cuda" if available else "cpu"


def _without_paths(key: str, value: Any) -> Any:  # noqa: ANN401 (a prior's option, whatever it is)
    """``value`` with a hash of the content in place of every file or folder that it names."""
    if isinstance(value, dict):
        return {inner: _without_paths(inner, part) for inner, part in value.items()}
    if isinstance(value, str) and (key == "weights" or os.sep in value) and Path(value).expanduser().exists():
        return f"content {content_of(Path(value).expanduser().resolve())}"
    return value


def content_of(path: Path) -> str:
    """SHA-256 (hex) over the names and bytes of a file, or of all files of a folder but its documents (a card decides nothing)."""
    try:
        files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file() and part.suffix != ".md")
        return _hash_files(path, tuple((file, file.stat().st_size, file.stat().st_mtime_ns) for file in files))
    except OSError as error:
        raise InputError(f"{shown(error.filename or path)}: expected a file that can be read, found: {error.strerror}") from None


@cache
def _hash_files(root: Path, files: tuple[tuple[Path, int, int], ...]) -> str:
    """Kept for as long as no size and no time of change differs: a table asks once for every cell."""
    digest = hashlib.sha256()
    for path, size, _ in files:
        digest.update(f"{path.relative_to(root).as_posix()}\0{size}\n".encode())
        with path.open("rb") as opened:
            while block := opened.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
