"""Where the real data is: IA_BENCH_REAL_DATA, else results/real. Tests that need it skip without it, and say how to get it."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def real_data() -> Path:
    folder = Path(os.environ.get("IA_BENCH_REAL_DATA", ROOT / "results" / "real"))
    if not (folder / "captures" / "banana").is_dir():
        pytest.skip(f"no real data in {folder}: make real-data, or IA_BENCH_REAL_DATA=FOLDER")
    return folder


@pytest.fixture(scope="session")
def fetch() -> ModuleType:
    """The script datasets/real/fetch.py, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("fetch_real_data", ROOT / "datasets" / "real" / "fetch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
