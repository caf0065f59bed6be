"""``make docs`` fails on a broken link, an orphaned page and a word that search does not find; its page of settings is complete."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from ia_bench.common.settings import flat
from ia_bench.report.collect import as_table, read_published
from ia_bench.runs.composition import compose
from ia_bench.runs.table import load_table

ROOT = Path(__file__).resolve().parents[2]
SITE, BUILT = ROOT / "docs" / "site", ROOT / "results" / "docs"
PYTHON = ROOT / ".venv-docs" / "bin" / "python"  # made by `make docs`, which CI runs before the tests
HEADINGS = "# Start\n\n## What to cite\n\n## A prior\n\n## A GPU\n\n## The licence\n\n[the log](docs/log/a.md)\n"
needs_mkdocs = pytest.mark.skipif(not PYTHON.exists(), reason="`make docs` has made no .venv-docs here")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project of two pages, one of them in the log, with the configuration of the real one but for its navigation."""
    (tmp_path / "docs" / "site").mkdir(parents=True)
    for file in ("wide.css", "iframe-worker.js"):
        shutil.copy(SITE / file, tmp_path / "docs" / "site")
    shared, _, _ = (SITE / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")
    (tmp_path / "docs" / "site" / "mkdocs.yml").write_text(f"{shared}\nnav:\n  - README.md\n", encoding="utf-8")
    write(tmp_path / "README.md", HEADINGS)
    write(tmp_path / "docs" / "log" / "a.md", "# A log\n")
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")


def build(root: Path) -> tuple[int, str]:
    done = subprocess.run([PYTHON, SITE / "build.py", root], capture_output=True, text=True, env={"NO_MKDOCS_2_WARNING": "1"})
    return done.returncode, done.stderr


@needs_mkdocs
def test_a_sound_project_is_built_with_its_pictures_whole_and_the_report_linked_first(root: Path) -> None:
    page, site = root / "results" / "published" / "page", root / "results" / "docs"
    (page / "parts").mkdir(parents=True)
    write(page / "index.html", "<title>Table</title>")
    write(page / "parts" / "pictures.js", "window.benchPictures={};")
    (root / "docs" / "a.webp").write_bytes(b"RIFF")
    write(root / "docs" / "log" / "a.md", "# A log\n\n![what is in it](../a.webp)\n")
    assert build(root) == (0, "")
    shown = (site / "docs" / "log" / "a.html").read_text(encoding="utf-8")
    assert re.search(r'<a href="../a.webp"><img [^>]*src="../a.webp"', shown)
    assert (site / "docs/results/page/parts/pictures.js").is_file()
    article = (site / "index.html").read_text(encoding="utf-8").partition("<article")[2]
    links = [link for link in re.findall(r'href="([^"]+)"', article) if not link.startswith("#")]
    assert links[0] == "docs/results/page/index.html"


@needs_mkdocs
@pytest.mark.parametrize(
    ("page", "text", "said"),
    [
        ("README.md", HEADINGS + "\n[nothing](docs/nothing.md)\n", "'docs/nothing.md'"),
        ("README.md", HEADINGS + "\n[nowhere](#nowhere)\n", "'#nowhere'"),
        ("docs/orphan.md", "# Nobody links here\n", "docs/orphan.md"),
        ("README.md", HEADINGS.replace("GPU", "card"), "found none with gpu"),
    ],
    ids=["broken link", "broken anchor", "orphaned page", "word that search does not find"],
)
def test_a_mistake_fails_the_build(root: Path, page: str, text: str, said: str) -> None:
    write(root / page, text)
    status, errors = build(root)
    assert status != 0
    assert said in errors


def reported(*variables: str) -> tuple[str, str]:
    """The runs and the table of the page that ``make docs`` writes."""
    command, bare = ["make", "-n", "docs", *variables], {"PATH": os.environ["PATH"]}  # not what another make was told
    said = subprocess.run(command, cwd=ROOT, env=bare, capture_output=True, text=True, check=True).stdout
    (line,) = (line for line in said.splitlines() if "ia-bench report" in line)
    words = shlex.split(line)
    return words[words.index("report") + 1], words[words.index("--table") + 1]


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_the_page_that_the_site_links_first_is_of_the_table_whose_runs_it_shows() -> None:
    """Every row of the table has runs, and every run is of a row; runs that are named are of the table that is named."""
    runs, table = reported()
    assert {row.name for row in load_table(table).crossed_rows} == set(as_table(read_published(ROOT / runs))["row"])
    assert reported("RUNS=results/some", "TABLE=value") == ("results/some", "value")
    assert reported("RUNS=results/paper") == ("results/paper", "paper")


WIDEST = ("index", "docs/settings", "docs/value", "docs/results/report", "docs/results/page/index", "datasets/index")


@pytest.mark.skipif(not BUILT.is_dir(), reason="`make docs` has built no site here")
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["widest", "every"])
@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1280, "dark")])
def test_no_page_is_wider_than_the_window(browser: Any, width: int, scheme: str, every: bool) -> None:
    """Wide tables and code scroll by themselves. Nothing is asked of a network, and no console complains.

    So it is when the page has turned from light to dark, or back, which takes no time beside loading it again.
    """
    schemes = scheme, {"light": "dark", "dark": "light"}[scheme]
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    opened, wrong = context.new_page(), []
    opened.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    opened.on("request", lambda request: wrong.append(request.url) if request.url.startswith("http") else None)
    pages = [BUILT / f"{page}.html" for page in WIDEST]
    if every:  # but for the one that a server shows in place of a page that is missing
        pages = sorted(set(BUILT.rglob("*.html")) - {BUILT / "404.html"})
    for page in pages:
        opened.emulate_media(color_scheme=scheme)
        opened.goto(page.as_uri(), timeout=0)
        for shown in schemes:
            opened.emulate_media(color_scheme=shown)
            wrong += [(page, shown)] if opened.evaluate("document.documentElement.scrollWidth") > width else []
    context.close()
    assert wrong == []


def test_every_page_of_the_log_is_reached_from_its_first() -> None:
    log = ROOT / "docs" / "log"
    linked = set(re.findall(r"\]\(([\w-]+\.md)\)", (log / "README.md").read_text(encoding="utf-8")))
    assert {path.name for path in log.glob("*.md")} - {"README.md"} <= linked


def test_the_page_of_settings_has_every_setting_with_its_meaning(tmp_path: Path) -> None:
    """Those of a run that chooses nothing, as ``--cfg job`` prints them; names and classes are choices and no settings."""
    subprocess.run([sys.executable, SITE / "settings.py", tmp_path / "settings.md"], check=True)
    tables = (tmp_path / "settings.md").read_text(encoding="utf-8")
    lines = dict(re.findall(r"^\| `([\w.]+)` \|.*\| (.*) \|$", tables, re.MULTILINE))
    config = {key: value for key, value in asdict(compose([])).items() if key != "command"}
    keys = {key.replace("method.options.", "fit.") for key in flat(config)}
    choices = {key for key in keys if re.fullmatch(r"(scene|reader|prior|method|coupling)\.(name|path|target)|preset|fit", key)}
    assert not {key for key in keys - choices - lines.keys() if not key.endswith("options")}
    assert not [key for key, meaning in lines.items() if not meaning.strip()]
    assert "| `reader.options.validation` | `[9, 18, " in tables, "a value, and not the constant that it has in the source"
