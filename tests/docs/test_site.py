"""``make docs`` fails on a link that leads nowhere and on a page that is in no menu: tiny trees, configured as the site is."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".venv-docs" / "bin" / "python"


@pytest.mark.skipif(not PYTHON.is_file(), reason="`make docs` makes the environment that builds the site")
@pytest.mark.parametrize(
    ("readme", "orphan", "said"),
    [
        ("[a page](docs/there.md)", False, ""),
        ("[a page](docs/gone.md)", False, "docs/gone.md"),
        ("[a page](docs/there.md#no-such-heading)", False, "no-such-heading"),
        ("[a page](docs/there.md)", True, "docs/orphan.md"),
    ],
    ids=["sound", "broken link", "broken anchor", "orphaned page"],
)
def test_what_is_broken_fails_the_build(readme: str, orphan: bool, said: str, tmp_path: Path) -> None:
    site = shutil.copytree(ROOT / "docs" / "site", tmp_path / "docs" / "site")
    configuration, _, _ = (site / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:\n  - Start")
    (site / "mkdocs.yml").write_text(configuration + "nav:\n  - README.md\n  - docs/there.md\n", encoding="utf-8")
    (tmp_path / "README.md").write_text(f"# Start\n\n{readme}\n")
    (tmp_path / "docs" / "there.md").write_text("# There\n")
    if orphan:
        (tmp_path / "docs" / "orphan.md").write_text("# In no menu\n")
    ended = subprocess.run(
        [PYTHON, ROOT / "docs" / "site" / "build.py", tmp_path],
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert (ended.returncode != 0) == bool(said), ended.stderr
    assert said in ended.stderr
    assert (tmp_path / "results" / "docs" / "index.html").is_file() or said
