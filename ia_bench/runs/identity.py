"""What makes a run the run that it is: everything that decides its numbers, and the hash of it.

Priors, couplings, methods and readers say themselves which files they take numbers from, by ``files``; nothing else is hashed.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.files import files_below, hash_of_files, mapped, path_in, paths_in, shown
from ia_bench.common.machine import environment
from ia_bench.common.ranges import NO_NUMBER
from ia_bench.runs.config import ReaderConfig, RunConfig, SceneConfig, expect_outside, method_of, resolve_scene_folder, slug

IDENTITY_VERSION = 20
"""Part of every hash; raised when a change of the code changes the numbers of an unchanged configuration."""
LABELS = ("command", "out", "row", "preset", "fit")
"""Settings that decide no number: what a run is called, where its results go, and what other settings already hold."""
CONTENT = "content"
"""What stands in an identity for a path: where a file lies decides no number."""


def identity(config: RunConfig) -> dict[str, Any]:
    """Everything that decides the numbers of a resolved run, as JSON types: its settings, and hashes of code and files.

    Code counts by IDENTITY_VERSION, and of plugins that are not the package's own by a hash
    (:func:`ia_bench.common.registry.foreign_code`). Files are those that a plugin says it takes numbers from: a prior, a coupling
    or a method by a class method ``files(options)``, a reader by its method ``files()``. Where one says nothing, they are those
    that its options name, and with a reader everything below the scene's folder.
    """
    content = {key: value for key, value in _deciding(config).items() if key not in LABELS}
    method = method_of(config)
    hidden = [field.name for field in fields(method.Options) if field.metadata == NO_NUMBER]
    content["method"]["options"] = {key: value for key, value in config.method.options.items() if key not in hidden}
    content["method"]["fingerprint"] = getattr(method, "fingerprint", None)
    for plugin, options in _plugins(config):
        paths, folders = _files_of(plugin, options), paths_in(options)
        content[plugin.kind] |= {
            "options": {
                key: mapped(value, partial(_without_path, paths)) if key in options else value
                for key, value in content[plugin.kind]["options"].items()
            },
            "files": [_content(_named_below(path, folders), [path]) for path in paths if plugin.kind != "reader"],
            "code": registry.foreign_code(plugin.kind, plugin.name, plugin.target),
        }
    content["scene"] = {"name": config.scene.name, "content": scene_content(config.scene, config.reader)}
    content["protocol"] = config.protocol.describe()
    content["identity_version"] = IDENTITY_VERSION
    reader = content.pop("reader")  # whose other options lie in its folder
    named = {path: _content(path) for path in paths_in(content)}  # of what is no plugin: a protocol, a capture
    return {**mapped(content, lambda text: named.get(path_in(text), text)), "reader": reader}  # type: ignore[arg-type]


def scene_content(scene: SceneConfig, reader: ReaderConfig) -> str | None:
    """SHA-256 (hex) over the files of a scene that its reader reads; None where it says of none and was given no folder."""
    folder = resolve_scene_folder(scene, reader)
    made = registry.create("reader", reader.name, reader.target, reader.options, folder)
    if hasattr(made, "files"):
        with registry.at_work("reader", reader.name):
            return _content(folder or Path(), map(Path, made.files()))
    if folder is None:
        return None
    return _content(folder, [folder, *paths_in(_outside(reader))])


def labels(config: RunConfig, content: Mapping[str, Any]) -> dict[str, Any]:
    """What every record of a run says from the start, failed or not; ``content``: its identity."""
    return {
        "row": config.row_name,
        "scene": config.scene.name,
        "seed": config.seed,
        "protocol": config.protocol.label,
        "preset": config.preset,
        "protocol_hash": protocol_hash(content),
        "environment": environment(config.device, config.threads or 1),
    }


def setup(config: RunConfig) -> dict[str, Any]:
    """What config.json keeps beside the identity: the command line and the configuration, which can be run again from anywhere."""
    paths = [path for plugin, options in _plugins(config) for path in _files_of(plugin, options)]
    settings = asdict(config)
    below = {key: value for key, value in settings["reader"]["options"].items() if key not in _outside(config.reader)}
    settings = from_anywhere(settings, paths)
    settings["reader"]["options"] |= below
    return {"command": shlex.join(("ia-bench", "run", *settings.pop("command"))), "config": settings}


def from_anywhere(settings: Mapping[str, Any], paths: Collection[Path] = ()) -> dict[str, Any]:
    """``settings`` that mean the same in every current folder: files and folders that they name, and ``paths``, are absolute."""
    found: dict[str, Any] = mapped(settings, lambda text: str(path_in(text, paths) or text))
    return found


def protocol_hash(content: Mapping[str, Any]) -> str:
    """The hash of what decides how a run is scored: the protocol and the scene's files. Raises KeyError for what is no identity."""
    return hash_of({"protocol": content["protocol"], "scene": content["scene"]["content"]})


def hash_of(content: Mapping[str, Any]) -> str:
    """SHA-256 (hex) over canonical JSON: sorted keys, no spaces."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def run_folder(config: RunConfig, key: str) -> Path:
    """Where a resolved run with the hash ``key`` leaves its results: ``out``, or ``runs/<scene>/<row>-<hash>``.

    Raises InputError for a place in the scene's folder.
    """
    if config.out is not None:
        folder = Path(config.out).expanduser()
    else:
        folder = Path("runs", slug(config.scene.name), f"{slug(config.row_name)}-{key[:8]}")
    expect_outside("out", folder, config.scene, config.reader)
    return folder


def _content(root: Path, paths: Iterable[Path] | None = None) -> str:
    """SHA-256 (hex) over names below ``root`` and bytes of the files among ``paths`` (None: ``root``), and all in its folders.

    Documents decide nothing.
    """
    try:
        found = [file for path in ([root] if paths is None else paths) for file in files_below(path)]
        return hash_of_files(root, [path for path in found if path.suffix != ".md"])
    except OSError as error:
        raise InputError(f"{shown(error.filename or root)}: expected a file that can be read, found: {error.strerror}") from None


def _plugins(config: RunConfig) -> Iterator[tuple[registry.Plugin, Mapping[str, Any]]]:
    """The plugins of a run with their options. A coupling that the prior will choose is one if it is of another distribution."""
    for kind in registry.KINDS:
        part = getattr(config, kind, None)
        if part is not None and part.target is not None:
            yield registry.named(kind, part.name, part.target), _outside(part) if kind == "reader" else part.options
    if config.coupling.target is None:
        prior = registry.load(registry.named("prior", config.prior.name, config.prior.target))
        recommended = getattr(getattr(prior, "info", None), "coupling", None)
        yield from ((plugin, {}) for name, plugin in registry.installed("coupling").items() if name == recommended)


def _outside(reader: ReaderConfig) -> Mapping[str, Any]:
    """The options by which a reader names files as the command line does: those in ``elsewhere`` of its class, or all."""
    keys = getattr(registry.load(registry.named("reader", reader.name, reader.target)), "elsewhere", reader.options)
    return {key: value for key, value in reader.options.items() if key in keys}


def _files_of(plugin: registry.Plugin, options: Mapping[str, Any]) -> list[Path]:
    """The files and folders that a plugin takes numbers from besides its code; a reader's own are its scene's."""
    said = getattr(registry.load(plugin), "files", None) if plugin.kind != "reader" else None
    if said is None:
        return paths_in(options)
    with registry.at_work(plugin.kind, plugin.name):
        return [Path(path).expanduser().resolve() for path in said(options)]


def _deciding(settings: Any) -> Any:  # noqa: ANN401 (a dataclass, or a value in one)
    """Settings as JSON types, without those fields that decide no number."""
    if not is_dataclass(settings):
        return settings
    return {field.name: _deciding(getattr(settings, field.name)) for field in fields(settings) if field.metadata != NO_NUMBER}


def _named_below(path: Path, folders: Iterable[Path]) -> Path:
    """The folder that an option names, below which the name of a file counts: it may say what the file is of."""
    return next((folder for folder in folders if folder != path and path.is_relative_to(folder)), path)


def _without_path(paths: Collection[Path], text: str) -> str:
    return CONTENT if path_in(text, paths) else text
