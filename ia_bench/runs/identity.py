"""What makes a run the run that it is: everything that decides its numbers, and the hash of it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from ia_bench.capture.settings import CaptureSettings, SdfSettings
from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.files import hash_of_files, is_file, shown, user_path
from ia_bench.common.machine import environment
from ia_bench.common.paths import PACKAGE
from ia_bench.common.ranges import NO_NUMBER
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.runs.config import RunConfig, options_class, resolve_scene_folder, slug

IDENTITY_VERSION = 9
"""Part of every hash; raised when a change of the code changes the numbers of an unchanged configuration."""

CONSISTENCY_VERSION, CONSISTENCY_KEY = 2, "consistency_version"
"""Like that, of what captures with ``capture.consistency`` alone go through; it stands among the settings of a capture."""

HASHED = "content "
"""What begins the text that stands in an identity for a path: the hash of what lies there follows."""

PACKAGED_WEIGHTS = PACKAGE / "priors" / "weights"
WEIGHTS = ("weights", "refiner")
"""Options that hold weights: a file or folder, by whatever name, or None for the packaged ones."""


def identity(config: RunConfig) -> dict[str, Any]:
    """Everything that decides the numbers of a resolved run, as JSON types.

    Left out: where results go, the row's label, the preset's name (its values are in), how often checkpoints are
    written, whether samples are kept, and where files lie. Instead of the path of the scene, or of a file that an option names,
    there is a hash of the content; the weights of the package count for every prior that takes some. Readers, priors and methods
    of other distributions, or of the command line, count with their code (:func:`ia_bench.common.registry.foreign_code`).
    """
    content = asdict(config)
    for label in ("out", "row", "preset", "fit"):
        del content[label]
    sdf = config.capture.sdf if config.capture.geometry == "sdf" else SdfSettings()
    if replace(config.capture, name=CaptureSettings.name, sdf=sdf) == CaptureSettings():
        del content["capture"]  # so that a scene as it is read has the identity that it had before there were captures
    else:
        del content["capture"]["name"]
        if config.capture.geometry != "sdf":
            del content["capture"]["sdf"]  # which then decides nothing
        else:
            content["capture"]["sdf"] = _of_sdf(sdf)
        if config.capture.consistency:
            content["capture"][CONSISTENCY_KEY] = CONSISTENCY_VERSION
    checked = {SupervisionSettings: content["prior"]["supervision"], options_class(config.method): content["method"]["options"]}
    for known, settings in checked.items():
        for field in fields(known):
            if field.metadata == NO_NUMBER:
                del settings[field.name]
    for kind in ("prior", "method", "reader"):
        content[kind]["options"] = _without_paths("options", content[kind]["options"])
    options = config.prior.options
    if "of_options" in options:  # of the prior that is sampled behind this one
        takes_packaged = (options["of_options"] or {}).get("weights") is None
    else:
        takes_packaged = any(name in options and options[name] is None for name in WEIGHTS)
    if takes_packaged:
        content["prior"]["packaged_weights"] = content_of(PACKAGED_WEIGHTS)
    foreign = {
        "prior": registry.foreign_code("prior", config.prior.name, config.prior.target),
        "prior.options.of": registry.foreign_code("prior", options["of"]) if isinstance(options.get("of"), str) else None,
        "method": registry.foreign_code("method", config.method.name, config.method.target),
        "reader": registry.foreign_code("reader", config.reader.name, config.reader.target),
    }
    if any(foreign.values()):
        content["foreign_code"] = {key: code for key, code in foreign.items() if code is not None}
    folder = resolve_scene_folder(config.scene, config.reader)
    content["scene"] = {"name": config.scene.name, "content": None if folder is None else content_of(folder)}
    protocol = config.protocol.describe()
    protocol["lpips"]["weights"] = _without_paths("weights", protocol["lpips"]["weights"])
    content["protocol"] = protocol
    content["identity_version"] = IDENTITY_VERSION
    return content


def _of_sdf(sdf: SdfSettings) -> dict[str, Any]:
    """How a surface is made; what came later is left out where it is off, so that runs without it are those that they were."""
    found = asdict(sdf)
    if not sdf.align:
        del found["align"]
    if sdf.normals == SdfSettings.normals:
        del found["normals"]
    else:
        found["normals"] = HASHED + content_of(user_path("capture.sdf.normals", sdf.normals, folder=True))
    return found


def given(config: RunConfig) -> dict[str, str]:
    """What :func:`identity` leaves out of a resolved run and reading the run again takes, by dotted key.

    The absolute path of everything of which it has a hash, and the name of the capture.
    """
    parts = {"prior": config.prior.options, "method": config.method.options, "reader": config.reader.options}
    found: dict[str, str] = {}
    for kind, options in parts.items():
        found |= _paths_in(f"{kind}.options", options)
    found |= _paths_in("protocol.lpips.weights", config.protocol.lpips.weights)
    if config.scene.path is not None:
        found["scene.path"] = str(user_path("scene.path", config.scene.path, folder=True))
    if config.capture.geometry == "sdf" and config.capture.sdf.normals != SdfSettings.normals:
        found["capture.sdf.normals"] = str(user_path("capture.sdf.normals", config.capture.sdf.normals, folder=True))
    if config.capture.name != CaptureSettings.name:
        found["capture.name"] = config.capture.name
    return found


def labels(config: RunConfig, content: Mapping[str, Any]) -> dict[str, Any]:
    """What every record of a run says from the start, failed or not; ``content``: its identity."""
    return {
        "row": config.row_name,
        "scene": config.scene.name,
        "seed": config.seed,
        "protocol": config.protocol.label,
        "preset": config.preset,
        "protocol_hash": hash_of({"protocol": content["protocol"], "scene": content["scene"]["content"]}),
        "environment": environment(config.device, config.threads or 1),
    }


def config_hash(config: RunConfig) -> str:
    """The run's identity: SHA-256 (hex) over the canonical JSON of :func:`identity`."""
    return hash_of(identity(config))


def hash_of(content: dict[str, Any]) -> str:
    """SHA-256 (hex) over canonical JSON: sorted keys, no spaces."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


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


def content_of(path: Path) -> str:
    """SHA-256 (hex) over the names and bytes of a file, or of all files of a folder but its documents (a card decides nothing)."""
    try:
        files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file() and part.suffix != ".md")
        return hash_of_files(path, files)
    except OSError as error:
        raise InputError(f"{shown(error.filename or path)}: expected a file that can be read, found: {error.strerror}") from None


def _without_paths(key: str, value: Any) -> Any:  # noqa: ANN401 (an option, whatever it is)
    """``value`` with a hash of the content in place of every file or folder that it names."""
    if isinstance(value, dict):
        return {inner: _without_paths(inner, part) for inner, part in value.items()}
    if isinstance(value, list | tuple):
        return [_without_paths(key, part) for part in value]
    path = _path_of(key, value)
    return value if path is None else HASHED + content_of(path)


def _paths_in(key: str, value: Any) -> dict[str, str]:  # noqa: ANN401 (an option, whatever it is)
    """The files and folders that :func:`_without_paths` would put a hash for, by dotted key; items of a list by their number."""
    if isinstance(value, dict | list | tuple):
        found: dict[str, str] = {}
        for name, part in value.items() if isinstance(value, dict) else enumerate(value):
            found |= _paths_in(f"{key}.{name}", part)
        return found
    words = key.split(".")
    path = _path_of(next(word for word in reversed(words) if not word.isdecimal()), value)
    return {} if path is None else {key: str(path)}


def _path_of(key: str, value: object) -> Path | None:
    """The file or folder that an option names; a word alone, which may be called like one by chance, names none."""
    if not isinstance(value, str) or not value:
        return None
    path = Path(value).expanduser()
    named = path.exists() if key in WEIGHTS or os.sep in value else bool(path.suffix) and is_file(path)
    return path.resolve() if named else None
