"""The examples of the API pages, and of the front door for Python, run as they stand."""

import os
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = [*sorted((DOCS / "api").glob("*.md")), DOCS / "python.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_example_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})  # one thread, as in every test
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert blocks, "every page shows how its contract is used"
    for block in blocks:
        assert "assert" in block
        exec(compile(block, str(page), "exec"), {"__name__": "__main__"})
