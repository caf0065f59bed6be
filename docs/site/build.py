"""``make docs``: lay out every document of the repository, with the files that they link to, and let MkDocs make a site of them.

Paths stay as they are in the repository, so that a link that works there works on the site; a link that leads nowhere fails the
build. Files that are no documents (a table, a picture, a module) are linked as they are.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STAGE = ROOT / "build" / "docs"
FOLDERS = ("docs", "datasets", "examples", "baselines", "training", "ia_bench")
LINK = re.compile(r"\]\(([^()\s#]+)[^()\s]*\)")


def documents() -> list[Path]:
    """All Markdown files of the repository that belong to it."""
    below = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.md"))
    return [ROOT / "README.md", ROOT / "CHANGELOG.md", *below]


def linked(document: Path) -> list[Path]:
    """The files of the repository that a document links to and that are no documents."""
    targets = (document.parent / target for target in LINK.findall(document.read_text(encoding="utf-8")))
    return [path.resolve() for path in targets if path.is_file() and path.suffix != ".md"]


def main() -> int:
    """Build the site into results/docs and return MkDocs's exit status."""
    shutil.rmtree(STAGE, ignore_errors=True)
    pages = documents()
    own = [Path(__file__).with_name(name) for name in ("wide.css", "iframe-worker.js")]
    for path in [*own, *pages, *(file for page in pages for file in linked(page))]:
        place = STAGE / path.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", str(Path(__file__).with_name("mkdocs.yml"))]
    return subprocess.call(command, cwd=ROOT)


if __name__ == "__main__":
    sys.exit(main())
