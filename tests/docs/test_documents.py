"""The documents: links and anchors resolve, what they name exists, and their lines can be reviewed.

Every Markdown file of the project is a case. A document that names a file, a module, a make target or a heading of another
document fails here when that is renamed. Reports below docs/results are written by the program; only their links are checked.
"""

import re
from functools import cache
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote

import pytest

from ia_bench.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("docs", "datasets", "examples", "baselines", "training", "ia_bench", "benchmarks")
BELOW = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.md"))
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *BELOW]
WRITTEN = [path for path in DOCUMENTS if not path.is_relative_to(ROOT / "docs" / "results")]
CURRENT = [path for path in WRITTEN if "log" not in path.parts]  # the log names files as they were called at the time
LONGEST = 160  # characters of a line; the aim is about 100

LINK = re.compile(r"(?<!`)\]\(([^()\s]+)\)")
CODE = re.compile(r"`([^`\n]+)`")
FILE = re.compile(r"(?<![\w./*<-])[\w.-]+(?:/[\w.-]+)+\.(?:py|yaml|toml)\b")


def name(path: Path) -> str:
    return str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)


@cache
def anchors(path: Path) -> frozenset[str]:
    """The anchors that GitHub gives to the headings of a document."""
    found: list[str] = []
    for heading in re.findall(r"^#+ +(.+?) *$", without_blocks(path.read_text(encoding="utf-8")), re.MULTILINE):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found.append(slug if slug not in found else f"{slug}-{found.count(slug)}")
    return frozenset(found)


def without_blocks(text: str) -> str:
    """A document without its fenced blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def code_of(text: str) -> list[str]:
    """Every span and every line of code in a document."""
    fenced = [line for block in re.findall(r"^```.*?^```$", text, re.MULTILINE | re.DOTALL) for line in block.splitlines()]
    prose = without_blocks(text)
    return [*CODE.findall(prose), *fenced, *re.findall(r"^    (.+)$", prose, re.MULTILINE)]


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_links_and_anchors_resolve(document: Path) -> None:
    broken = []
    for target in LINK.findall(without_blocks(document.read_text(encoding="utf-8"))):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        place, _, anchor = unquote(target).partition("#")
        linked = (document.parent / place).resolve() if place else document
        if not linked.exists():
            broken.append(f"{target}: no such file")
        elif anchor and anchor not in anchors(linked):
            broken.append(f"{target}: {name(linked)} has no such heading")
    assert not broken, "\n".join(broken)


@pytest.mark.parametrize("document", CURRENT, ids=name)
def test_files_that_are_named_exist(document: Path) -> None:
    """As seen from the project's root, from the packages, from the tests, or from the document itself."""
    folders = (".", "ia_bench", "baselines/ia_bench_baselines", "training", "tests")
    places = [*(ROOT / folder for folder in folders), document.parent]
    named = {file for code in code_of(document.read_text(encoding="utf-8")) for file in FILE.findall(code)}
    kept = {file for file in named if "results/" not in file and "NAME" not in file}  # made by a run, or to be filled in
    missing = sorted(file for file in kept if not any((place / file).exists() for place in places))
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("document", [path for path in WRITTEN if path.name != "CHANGELOG.md"], ids=name)
def test_commands_that_are_named_exist(document: Path) -> None:
    """``python -m MODULE`` of this project can be found and run, ``ia-bench COMMAND`` is one, ``make TARGET`` is a target."""
    code = code_of(document.read_text(encoding="utf-8"))
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    wrong = []
    for line in code:
        for module in re.findall(r"python -m ((?:ia_bench|benchmarks)[\w.]*)", line):
            places = [root / module.replace(".", "/") for root in (ROOT, ROOT / "baselines", ROOT / "training")]
            if not any(place.with_suffix(".py").is_file() or (place / "__main__.py").is_file() for place in places):
                wrong.append(f"python -m {module}")
        wrong += [f"ia-bench {name}" for name in re.findall(r"\bia-bench ([a-z]\w*)", line) if name not in COMMANDS]
        wrong += [f"make {target}" for target in re.findall(r"^make ([a-z-]+)", line) if target not in targets]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("document", CURRENT, ids=name)
def test_imports_that_are_shown_work(document: Path) -> None:
    shown = re.findall(r"^ *from (ia_bench[\w.]*) import ([\w, ]+)", document.read_text(encoding="utf-8"), re.MULTILINE)
    missing = [
        f"from {module} import {part}"
        for module, parts in shown
        for part in re.split(r", *", parts.strip())
        if not hasattr(import_module(module), part)
    ]
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("document", WRITTEN, ids=name)
def test_lines_can_be_reviewed(document: Path) -> None:
    """No line outside of tables and links is longer than :data:`LONGEST`."""
    long = []
    for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), 1):
        shown = re.sub(r"!?\[[^]]*\]\([^)]*\)", "", line)
        if not line.lstrip().startswith("|") and len(shown) > LONGEST:
            long.append(f"line {number}: {len(shown)} characters")
    assert not long, "\n".join(long)


@pytest.mark.parametrize("document", WRITTEN, ids=name)
def test_blocks_that_name_a_file_show_it_as_it_is(document: Path) -> None:
    """A fenced block whose first line is a comment with a path, such as ``# examples/NAME/file.py``, holds that file whole."""
    text = document.read_text(encoding="utf-8")
    for path, shown in re.findall(r"^```\w+\n# ([\w./-]+/[\w.-]+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        assert shown == (ROOT / path).read_text(encoding="utf-8"), f"{path} is another one now; show it as it is"


@pytest.mark.parametrize("document", [path for path in CURRENT if path.name != "CHANGELOG.md"], ids=name)
def test_documents_are_read_at_one_sitting(document: Path) -> None:
    """At most 250 lines, the README 110: what is longer says things twice, or belongs into the log."""
    lines = document.read_text(encoding="utf-8").count("\n")
    assert lines <= (110 if document == ROOT / "README.md" else 250), f"{name(document)}: {lines} lines"


def test_documents_together_are_few_enough_to_read() -> None:
    """Those of ``docs`` and ``docs/api``, without the log and the results, have at most 3500 lines."""
    lines = sum(
        path.read_text(encoding="utf-8").count("\n") for folder in ("docs", "docs/api") for path in (ROOT / folder).glob("*.md")
    )
    assert lines <= 3500, f"{lines} lines: what is added takes the place of something else"


def test_documents_that_code_names_exist() -> None:
    """In messages, docstrings and comments: ``docs/NAME.md``, with a heading where one follows."""
    folders = ("ia_bench", "conf", "baselines", "training", "benchmarks")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".yaml", ".toml", ".sh")]
    named = {found for path in files for found in re.findall(r"docs/[\w/-]+\.md(?:#[\w-]+)?", path.read_text(encoding="utf-8"))}
    missing = []
    for place, _, anchor in (text.partition("#") for text in named):
        document = ROOT / place
        if not document.is_file() or (anchor and anchor not in anchors(document)):
            missing.append(f"{place}#{anchor}")
    assert named
    assert not missing, "\n".join(sorted(missing))
