"""The tables of ``docs/settings.md``: every setting with its default and meaning, read from the sources without importing them.

A default and a meaning are those of a dataclass and its docstring, or of a YAML file below ``conf`` and its comments.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

RUN = "ia_bench.runs.config:RunConfig"
OF_A_RUN = ("seed", "device", "threads", "row", "out")
TABLES = {
    "fit": "ia_bench.methods.two_stage.settings:FitSettings",
    "render": "ia_bench.render.settings:RenderSettings",
    "capture": "ia_bench.capture.settings:CaptureSettings",
    "protocol": "ia_bench.scores.protocol:Protocol",
    "prior": "ia_bench.runs.config:PriorConfig",
}
"""What a setting begins with -> the dataclass whose fields it names."""

CHOSEN = {"coupling": "coupling.options", "regulariser": "fit.regulariser_options.{name}", "prior": "prior.options"}
CHOSEN |= {"reader": "reader.options", "method": "method.options"}
"""Folder of ``conf`` -> what the options of one of its choices begin with."""

SHARED = {"reader": "ia_bench.readers.base:FolderReader"}
"""Whose options all choices of such a folder have, told once."""


@dataclass(frozen=True)
class Setting:
    """One line of a table. ``allowed`` is empty where the default says enough."""

    key: str
    default: str
    allowed: str
    meaning: str


def page(root: Path) -> str:
    """The tables as Markdown, to stand below what ``docs/settings.md`` says."""
    parts = ["## A run", *table([one for one in settings(root, RUN) if one.key in OF_A_RUN])]
    for prefix, target in TABLES.items():
        parts += [f"## {prefix}", *table(settings(root, target, f"{prefix}."))]
    for folder, prefix in CHOSEN.items():
        shared = settings(root, SHARED[folder], f"{prefix}.") if folder in SHARED else []
        parts += [f"## Options of a {folder}", *(table(shared) if shared else [""])]
        for path in sorted((root / "conf" / folder).glob("*.yaml")):
            if found := [one for one in options(root, path, prefix.format(name=path.stem) + ".") if one not in shared]:
                parts += [f"### {folder}={path.stem}", *table(found)]
    return "\n".join(parts) + "\n"


def table(found: list[Setting]) -> list[str]:
    """The settings as the lines of a Markdown table."""
    rows = (f"| `{one.key}` | {code(one.default)} | {code(one.allowed)} | {one.meaning} |" for one in found)
    return ["", "| setting | default | allowed | what it is |", "| :--- | :--- | :--- | :--- |", *rows, ""]


def code(text: str) -> str:
    """The text as a span of code in a cell of a table."""
    return "`" + text.replace("|", "\\|") + "`" if text else ""


def options(root: Path, path: Path, prefix: str) -> Iterator[Setting]:
    """The options of the choice that a YAML file describes: as its comments have them, else as the class it names has them."""
    block = re.search(r"^options:.*\n((?:  .*\n)+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    named = re.findall(r"^  ([a-z_]+): (.+?)(?: +# (.*))?$", block[1], re.MULTILINE) if block else []
    if any(comment for _, _, comment in named):
        yield from (Setting(prefix + key, value, "", comment) for key, value, comment in named)
    elif target := re.search(r"^target: (\S+:\S+)$", path.read_text(encoding="utf-8"), re.MULTILINE):
        own = settings(root, target[1], prefix)
        yield from own if path.parent.name != "method" else settings(root, options_of(root, target[1]), prefix)


def options_of(root: Path, target: str) -> str:
    """The dataclass of a method's options, ``module:Class``; of ``two_stage`` it has a table of its own, and is left out."""
    module, name = target.split(":")
    found = next((item for item in of_class(root, module, name).body if "Options" in ast.unparse(item)), None)
    value = getattr(found, "value", None)
    return f"{module}:{value.id}" if isinstance(value, ast.Name) and value.id != "FitSettings" else ""


def settings(root: Path, target: str, prefix: str = "") -> list[Setting]:
    """The fields of a dataclass and of those that it contains or inherits from, with ``prefix`` before their names."""
    if not target:
        return []
    module, name = target.split(":")
    node, found = of_class(root, module, name), dict[str, Setting]()
    if not any("dataclass" in ast.unparse(one) for one in node.decorator_list):
        return []
    for base in node.bases:
        if isinstance(base, ast.Name) and (place := origin(root, module, base.id)):
            found |= {one.key: one for one in settings(root, place, prefix)}
    docstring = ast.get_docstring(node) or ""
    words = meanings(docstring)
    for_all = "" if words else plain(docstring.partition(". ")[0])
    for item in node.body:
        if not isinstance(item, ast.AnnAssign) or "ClassVar" in ast.unparse(item.annotation):
            continue
        key = ast.unparse(item.target)
        inner = re.search(r"default_factory=([A-Z]\w+)", ast.unparse(item.value) if item.value else "")
        if inner and (place := origin(root, module, inner[1])):
            found |= {one.key: one for one in settings(root, place, f"{prefix}{key}.")}
        elif key in words or item.value is not None:
            allowed = kind(root, module, item.annotation)
            said = words.get(key) or (found[prefix + key].meaning if prefix + key in found else for_all)
            found[prefix + key] = Setting(prefix + key, default(item.value), allowed, said)
    return [one for one in found.values() if one.default]


def default(value: ast.expr | None) -> str:
    """The default as a command line would have it."""
    text = ast.unparse(value) if value else ""
    if named := re.match(r"field\((?!default_factory)(?:.*?default=([^,)]+))?", text):
        text = named[1] or ""
    for written, shown in {"None": "null", "True": "true", "False": "false", "list": "[]", "dict": "{}"}.items():
        text = shown if re.fullmatch(rf"{written}|field\(default_factory={written}\)", text) else text
    return text.strip("'").replace("_", "") if re.fullmatch(r"[\d_]+", text) else text.strip("'")


def kind(root: Path, module: str, annotation: ast.expr) -> str:
    """What values are allowed: names, a range, or nothing where any of the default's type is."""
    text = ast.unparse(annotation)
    for name in set(re.findall(r"\b[A-Z]\w+", text)) - {"Annotated", "Field", "Literal", "None", "Path"}:
        if (place := origin(root, module, name)) and (meant := aliases(root, place.partition(":")[0]).get(name)):
            text = re.sub(rf"\b{name}\b", meant, text)
    text = re.sub(r"Literal\[(.*?)\]", lambda found: found[1].replace("'", ""), text)
    text = re.sub(r"Annotated\[(int|float), Field\((.*?)\)\]", lambda found: bounds(found[2]), text)
    if re.search(r"Annotated|bool|str|dict|list|tuple|int|float|Sequence", text):
        return ""
    return text.replace(" | None", ", null").replace(" | ", ", ")


def bounds(text: str) -> str:
    """The bounds "ge=0, le=1" as "0 ... 1"."""
    ends = dict(re.findall(r"(g[et]|l[et])=([^,]+)", text))
    least = ends.get("ge") or f"above {ends['gt']}"
    most = ends.get("le", "")
    return f"{least} ... {most}" if re.fullmatch(r"[\d.]{1,5}", most) else f"{least} ..."  # other ends only keep mistakes out


def meanings(docstring: str) -> dict[str, str]:
    """Name of a field -> what the docstring says of it, under "Attributes:" or in a sentence that names it."""
    found = dict[str, str]()
    head, _, block = docstring.partition("Attributes:\n")
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


@cache
def tree(root: Path, module: str) -> ast.Module:
    """A module, parsed."""
    return ast.parse((root / (module.replace(".", "/") + ".py")).read_text(encoding="utf-8"))


def of_class(root: Path, module: str, name: str) -> ast.ClassDef:
    """A class of a module."""
    return next(node for node in tree(root, module).body if isinstance(node, ast.ClassDef) and node.name == name)


def origin(root: Path, module: str, name: str) -> str:
    """Where a name of a module is defined, ``module:name``; empty for what is none of ours."""
    for node in ast.walk(tree(root, module)):
        if isinstance(node, ast.ImportFrom) and any(one.name == name for one in node.names):
            return f"{node.module}:{name}" if str(node.module).startswith("ia_bench") else ""
    own = {node.name for node in tree(root, module).body if isinstance(node, ast.ClassDef)} | set(aliases(root, module))
    return f"{module}:{name}" if name in own else ""


def aliases(root: Path, module: str) -> dict[str, str]:
    """The types that a module gives a name: ``Weight = Annotated[...]``."""
    assigned = (node for node in tree(root, module).body if isinstance(node, ast.Assign))
    found = {ast.unparse(node.targets[0]): ast.unparse(node.value) for node in assigned}
    named = {name: value for name, value in found.items() if re.match(r"Annotated|Literal|\w+ \| Literal", value)}
    return {name: re.sub(r"\b[A-Z]\w+\b", lambda word: named.get(word[0], word[0]), value) for name, value in named.items()}
