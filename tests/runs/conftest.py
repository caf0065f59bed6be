"""The folders of shipped scenes."""

import json
from pathlib import Path

import pytest

from ia_bench.common.paths import conf_folder


@pytest.fixture
def scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Scene folders of every shipped name, with just enough in them to be told apart."""
    root = tmp_path / "datasets" / "scenes"
    for path in conf_folder().glob("scene/*.yaml"):
        (root / path.stem).mkdir(parents=True)
        (root / path.stem / "scene.json").write_text(json.dumps({"name": path.stem}))
    monkeypatch.setenv("IA_BENCH_DATASETS", str(tmp_path / "datasets"))
    return root
