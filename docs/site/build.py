"""``make docs``: lay out every document of the repository, with the files that they link to, and let MkDocs make a site of them.

Paths stay as they are in the repository, so that a link that works there works on the site; a link that leads nowhere fails the
build, and so does a document that is neither in the navigation nor part of the log. Files that are no documents (a table, a
picture, a module) are linked as they are.

What ``make docs`` has written before has its places: the tables of settings (``settings.py``), and the page of the published table
(``ia-bench report``), which is the first that the home links to.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOP = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
FOLDERS = ("docs", "datasets", "examples", "baselines", "training", "ia_bench")
SETTINGS, TABLES = Path("docs/settings.md"), Path("results/published/settings.md")
REPORT, PLACE = Path("results/published/page"), Path("docs/results/page")
"""The report page in the repository's results, and where it is in the site."""
FIRST = f"[The published table as a page]({PLACE}/index.html), to sort, to look at what was recovered, and behind every number."
FOUND = ("cite", "prior", "gpu", "licence")
"""Words that a reader types into the search box, each of which a heading answers."""

PICTURE = re.compile(r"^(!\[[^]\n]*\]\(([^()\s]+)\))$", re.MULTILINE)
"""A picture in a line of its own, which a click shows as large as it is: a page is often too narrow for what is written in it."""
LINK = re.compile(r"\]\(([^()\s#]+)[^()\s]*\)")


def documents(root: Path) -> list[Path]:
    """All Markdown files of the repository that belong to it."""
    below = sorted(path for folder in FOLDERS for path in (root / folder).rglob("*.md"))
    return [path for name in TOP if (path := root / name).is_file()] + below


def linked(document: Path) -> list[Path]:
    """The files of the repository that a document links to and that are no documents."""
    targets = (document.parent / target for target in LINK.findall(document.read_text(encoding="utf-8")))
    return [path.resolve() for path in targets if path.is_file() and path.suffix != ".md"]


def unanswered(site: Path) -> list[str]:
    """The words of ``FOUND`` that no heading in the search index of a built site holds."""
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    headings = " ".join(section["title"].lower() for section in index["docs"])
    return [word for word in FOUND if not re.search(rf"\b{word}s?\b", headings)]


def main(root: Path = ROOT) -> int:
    """Build the site of the repository ``root`` into its results/docs and return MkDocs's exit status.

    What MkDocs says is shown from warnings on, of which each fails the build. (With its own --quiet it counts no warning.)
    """
    stage, site = root / "build" / "docs", root / "docs" / "site"
    shutil.rmtree(stage, ignore_errors=True)
    pages = documents(root)
    for path in [site / "wide.css", site / "iframe-worker.js", *pages, *(file for page in pages for file in linked(page))]:
        place = stage / path.relative_to(root)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
        if path.suffix == ".md":
            place.write_text(PICTURE.sub(r"[\1](\2)", path.read_text(encoding="utf-8")), encoding="utf-8")
    if (root / TABLES).is_file():
        with (stage / SETTINGS).open("a", encoding="utf-8") as page:
            page.write("\n" + (root / TABLES).read_text(encoding="utf-8"))
    if (root / REPORT).is_dir():
        shutil.copytree(root / REPORT, stage / PLACE)
        title, _, text = (stage / "README.md").read_text(encoding="utf-8").partition("\n")
        (stage / "README.md").write_text(f"{title}\n\n{FIRST}\n{text}", encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--config-file", str(site / "mkdocs.yml")]
    ended = subprocess.run(command, cwd=root, capture_output=True, text=True)
    if ended.returncode:
        print("\n".join(line for line in ended.stderr.splitlines() if not line.startswith("INFO")), file=sys.stderr)
    if not ended.returncode and (words := unanswered(root / "results" / "docs")):
        print(f"search: expected a heading with each of {', '.join(FOUND)}, found none with {', '.join(words)}", file=sys.stderr)
        return 1
    return ended.returncode


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
