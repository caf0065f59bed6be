"""From command-line overrides to a RunConfig through Hydra, and from Hydra's errors to one message to act on."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common import registry
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.files import shown
from ia_bench.common.paths import conf_folder
from ia_bench.common.ranges import LONGEST_NAME
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.config import RunConfig, resolved
from ia_bench.scores.protocol import Protocol

OPTIONS = ("fit.", "method.options.", "prior.options.", "coupling.options.", "reader.options.")
"""What begins the names of settings that belong to a plugin."""
PLAIN = re.compile(r"(?!(?i:null|true|false|nan|inf)$)[./]*[A-Za-z_][A-Za-z0-9_./-]*")
"""Texts that Hydra takes for texts without quotes."""
_stored: dict[tuple[str | None, str], dict[str, Any]] = {}


def register(chosen: Mapping[str, str]) -> None:
    """Tell Hydra the settings of a run, with their defaults, and every plugin that has no YAML file of its own.

    Plugins are the installed ones and those that are ``chosen`` as ``module:Class``, by kind. Types and ranges are checked
    once all is composed (:func:`ia_bench.runs.config.resolved`).
    """
    defaults: dict[str, Any] = {f.name: f.default for f in fields(RunConfig) if f.default is not MISSING and f.name != "command"}
    defaults |= {"capture": asdict(CaptureSettings()), "protocol": asdict(Protocol()), "render": asdict(RenderSettings())}
    defaults |= {kind: {"options": {}} for kind in ("reader", "coupling", "method")}
    defaults |= {"scene": {"path": None}, "preset": None, "prior": {"options": {}, "views": "auto", "cache": True}}
    _store(None, "schema", defaults)
    for kind in registry.KINDS:
        if kind == "regulariser":
            continue  # no group: fit.regularise has a list of their names
        value = chosen.get(kind, "")
        registry.expect_no_path(kind, value)
        for plugin in [*registry.installed(kind).values(), *([registry.find(kind, value)] if ":" in value else [])]:
            _store(kind, plugin.name, {"name": plugin.name, "target": plugin.target})


def _store(group: str | None, name: str, content: dict[str, Any]) -> None:
    """Tell Hydra a configuration, unless it is the one that was told last: that takes longer than a comparison."""
    if _stored.get((group, name)) != content:
        ConfigStore.instance().store(group=group, name=name, node=OmegaConf.create(content))
        _stored[group, name] = content


def written(value: Any, key: str = "setting") -> str:  # noqa: ANN401 (of a setting)
    """A value as Hydra's grammar has it, whatever characters it holds. Raises InputError, naming ``key``, for what JSON has not."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{written(name, key)}: {written(part, key)}" for name, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(written(part, key) for part in value)}]"
    if isinstance(value, str | Path):
        escaped = re.sub(r"(\\*)('|$)", lambda found: 2 * found[1] + ("\\'" if found[2] else ""), str(value))
        return f"'{escaped}'"
    try:
        return json.dumps(value.item() if isinstance(value, np.generic) else value)
    except (TypeError, ValueError):
        raise InputError(f"{key}: expected a number, a text, a list or a table, found {type(value).__name__}") from None


def setting(key: str, value: Any) -> str:  # noqa: ANN401 (of a setting)
    """``key=value`` for :func:`compose`; a text stands without quotes where it can."""
    return f"{key}={value}" if isinstance(value, str | Path) and PLAIN.fullmatch(str(value)) else f"{key}={written(value)}"


def scene_setting(text: str, others: Sequence[str]) -> str:
    """``scene=NAME`` or ``scene.path=FOLDER`` for what a command takes as either, beside ``others``, its settings.

    A text with a ``/``, or that begins with a dot, is a folder; so is any that is there, but for the name of a shipped scene where
    no other reader than the native one is set.
    """
    reads = any(one.startswith("reader=") and one != "reader=native" for one in others)
    named = (conf_folder() / "scene" / f"{text}.yaml").is_file() and not reads
    folder = "/" in text or text.startswith(".") or (Path(text).is_dir() and not named)
    return setting("scene.path" if folder else "scene", text)


def compose(overrides: Sequence[str], here: bool = True) -> RunConfig:
    """The resolved configuration of ``ia-bench run <overrides>``. Raises InputError for what it cannot mean.

    ``here``: see :func:`ia_bench.runs.config.resolved`.
    """
    given, parts = tuple(overrides), [text.partition("=") for text in overrides]
    chosen = {key: value.strip("'\" ") for key, _, value in parts}
    overrides = [f"++{text}" if text.startswith(OPTIONS) else text for text in overrides]  # keys that no file needs to have
    overrides = [re.sub(r"^([+~]?(\w+)(?:@\w+)?)=\s*(.*?)\s*$", _group_by_name, text, flags=re.DOTALL) for text in overrides]
    if ("scene.path" in chosen or chosen.get("reader", "native") != "native") and "scene.name" not in chosen:
        overrides.append("scene.name=''")  # which is then what its reader calls it, and no shipped scene
    register(chosen)
    try:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            content = OmegaConf.to_container(hydra_compose("config", list(overrides)), resolve=True)
    except (HydraException, OmegaConfBaseException, ValueError) as error:  # the last of what no group can be, such as a number
        raise InputError(explain(error)) from error
    assert isinstance(content, dict)
    config = replace(resolved({str(key): value for key, value in content.items()}, here), command=given)
    asked = chosen.get("coupling", config.coupling.name)
    if asked != config.coupling.name:  # a prior's file that sets a coupling comes after it
        prior, brought = config.prior, config.coupling.name
        plain = next((name for name, plugin in registry.built_in("prior").items() if plugin.target == prior.target), prior.name)
        instead = f"use prior={plain} coupling={asked}"
        raise InputError(f"coupling: expected {brought}, which prior={prior.name} brings, found {asked}; {instead}")
    return config


def _group_by_name(setting: re.Match[str]) -> str:
    """``GROUP=VALUE`` with a text as the value: a number or null names no file, which Hydra then says in its own words.

    Raises InputError for a list, of which Hydra would take the last one, and for what no file can be called.
    """
    group, key, value = setting.groups()
    if not (conf_folder() / key).is_dir():
        return setting[0]
    if key == "regulariser":
        raise InputError(f"{setting[0]}: expected fit.regularise=[{value}], a list of names, since there may be several")
    if re.fullmatch(r"\[.*\]", value) or not value.isprintable() or (len(value) > LONGEST_NAME and value[0] != "{"):
        raise InputError(f"{key}: expected one name, found {shown(value)}")
    return f"{group}='{value}'" if re.fullmatch(r"[\w.+-]+", value) else setting[0]


def explain(error: Exception) -> str:
    """What a user needs to know of an error of Hydra or OmegaConf: key, what was expected, closest right name."""
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = str(error.missing_cfg_file).partition("/")
        instead = "; a folder is scene.path=FOLDER" if group == "scene" and "/" in name else ""
        return unknown(group, name, sorted(error.options or ())) + instead
    if isinstance(error, OverrideParseException):
        first = str(error.message).splitlines()[0]
        written = str(error.override).removeprefix("++")
        advice = "quote values that contain , = : # ( ), quotes, spaces or letters beyond ASCII"
        return f"cannot read '{written}': {first}. Expected key=value; {advice}"
    if isinstance(cause, ConfigKeyError | ConfigAttributeError) and cause.full_key:
        parent, _, last = str(cause.full_key).rpartition(".")
        node = cause.parent_node
        names = sorted(str(name) for name in node if name != "hydra") if isinstance(node, DictConfig) else []
        return unknown("setting", re.split(r"[.@]", last)[0], names, prefix=f"{parent}." if parent else "")
    if isinstance(cause, OmegaConfBaseException):
        return (f"{cause.full_key}: " if cause.full_key else "") + str(cause).splitlines()[0]
    text = " ".join(str(error).split())
    if several := re.match(r"Ambiguous value for argument '([^']+)'", text):
        key = several[1].removeprefix("++")
        return f"{key}: expected one value; several runs are a table: ia-bench table seeds=0,1 scenes=hat,ship"
    return text
