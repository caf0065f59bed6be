"""The tables of ``docs/settings.md``: every setting with its default, what is allowed, and its meaning.

    python docs/site/settings.py FILE.md

A default and a meaning are those of a dataclass and its docstring, or of a YAML file below ``conf`` and its comments.
"""

from __future__ import annotations

import inspect
import re
import sys
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common import registry
from ia_bench.common.files import read_yaml
from ia_bench.common.paths import conf_folder
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.readers.base import FolderReader
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.composition import setting
from ia_bench.runs.config import PriorConfig, RunConfig
from ia_bench.scores.protocol import Protocol

OF_A_RUN = ("seed", "device", "threads", "row", "out")
TABLES = {"fit": FitSettings, "render": RenderSettings, "capture": CaptureSettings, "protocol": Protocol, "prior": PriorConfig}
"""What a setting begins with -> the dataclass whose fields it names."""

CHOSEN = {"coupling": "coupling.options", "regulariser": "fit.regulariser_options.{name}", "prior": "prior.options"}
CHOSEN |= {"reader": "reader.options", "method": "method.options"}
"""Folder of ``conf`` -> what the options of one of its choices begin with."""

SHARED = {"reader": FolderReader}
"""Whose options all choices of such a folder have, told once."""


@dataclass(frozen=True)
class Setting:
    """One line of a table. ``allowed`` is empty where the default says enough."""

    key: str
    default: str
    allowed: str
    meaning: str


def page() -> str:
    """The tables as Markdown, to stand below what ``docs/settings.md`` says."""
    parts = ["## A run", *table([one for one in settings(RunConfig) if one.key in OF_A_RUN])]
    for prefix, kind in TABLES.items():
        parts += [f"## {prefix}", *table(settings(kind, f"{prefix}."))]
    for folder, prefix in CHOSEN.items():
        shared = settings(SHARED[folder], f"{prefix}.") if folder in SHARED else []
        parts += [f"## Options of a {folder}", *(table(shared) if shared else [""])]
        for path in sorted((conf_folder() / folder).glob("*.yaml")):
            if found := [one for one in options(path, prefix.format(name=path.stem) + ".") if one not in shared]:
                parts += [f"### {folder}={path.stem}", *table(found)]
    return "\n".join(parts) + "\n"


def table(found: list[Setting]) -> list[str]:
    """The settings as the lines of a Markdown table."""
    rows = (f"| `{one.key}` | {code(one.default)} | {code(one.allowed)} | {one.meaning} |" for one in found)
    return ["", "| setting | default | allowed | what it is |", "| :--- | :--- | :--- | :--- |", *rows, ""]


def code(text: str) -> str:
    """The text as a span of code in a cell of a table."""
    return "`" + text.replace("|", "\\|") + "`" if text else ""


def options(path: Path, prefix: str) -> list[Setting]:
    """The options of the choice that a YAML file describes: as its comments have them, else as the class it names has them."""
    block = re.search(r"^options:.*\n((?:  .*\n)+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    named = re.findall(r"^  ([a-z_]+): (.+?)(?: +# (.*))?$", block[1], re.MULTILINE) if block else []
    if any(comment for _, _, comment in named):
        return [Setting(prefix + key, value, "", comment) for key, value, comment in named]
    if not read_yaml(path).get("target"):
        return []
    kind = registry.load(registry.find(path.parent.name, path.stem))
    kind = kind.Options if path.parent.name == "method" else kind
    return settings(kind, prefix) if is_dataclass(kind) and kind is not FitSettings else []  # that has a table of its own


def settings(kind: type, prefix: str = "") -> list[Setting]:
    """The fields of a dataclass that have a default, and those of dataclasses within, with ``prefix`` before their names."""
    hints, words, found = get_type_hints(kind, include_extras=True), dict[str, str](), []
    for base in reversed(kind.__mro__):
        own = vars(base).get("__annotations__", ())
        words |= {name: said for name, said in meanings(base.__doc__ or "").items() if name in own}
    for item in fields(kind):
        value = item.default if item.default_factory is MISSING else item.default_factory()
        if is_dataclass(value):
            found += settings(type(value), f"{prefix}{item.name}.")
        elif value is not MISSING:
            meaning = words.get(item.name) or plain((kind.__doc__ or "").partition(". ")[0])
            found.append(Setting(prefix + item.name, setting("", value)[1:], allowed(hints[item.name]), meaning))
    return found


def allowed(hint: Any) -> str:  # noqa: ANN401 (a type)
    """What values are allowed: names, a range, or nothing where any of the default's type is."""
    parts = [named(part) for part in (get_args(hint) if get_origin(hint) in (Union, UnionType) else [hint])]
    return ", ".join(parts) if all(parts) else ""


def named(part: Any) -> str:  # noqa: ANN401 (a type)
    """The names of a Literal, or the bounds of a number: "0 ... 1"."""
    if part is type(None):
        return "null"
    if get_origin(part) is Literal:
        return ", ".join(map(str, get_args(part)))
    if get_origin(part) is not Annotated or get_args(part)[0] not in (int, float):
        return ""
    ends = dict(re.findall(r"(g[et]|l[et])=([^,)]+)", str(get_args(part)[1].metadata)))
    least, most = ends.get("ge") or f"above {ends['gt']}", ends.get("le", "")
    return f"{least} ... {most}" if re.fullmatch(r"[\d.]{1,5}", most) else f"{least} ..."  # other ends only keep mistakes out


def meanings(docstring: str) -> dict[str, str]:
    """Name of a field -> what the docstring says of it, under "Attributes:" or in a sentence that names it."""
    found = dict[str, str]()
    head, _, block = inspect.cleandoc(docstring).partition("Attributes:\n")
    for names, text in re.findall(r"^    (\w+(?:, \w+)*): (.*(?:\n        .*)*)", block, re.MULTILINE):
        found |= {name: plain(text) for name in names.split(", ")}
    for sentence in re.split(r"(?<=[.;])\s+(?=[A-Z`])", head):
        for name in re.findall(r"``(\w+)``", sentence):
            found.setdefault(name, plain(sentence))
    return found


def plain(text: str) -> str:
    """A docstring's words as Markdown on one line."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", " ".join(text.split()).replace("``", "`"))
    return re.sub(r"\bNone\b", "null", text).replace("|", "\\|").rstrip(";")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
