"""What every test shares: one thread, the shipped scene `tiny`, a copy of it that may be broken, a run on it, and a browser."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from coarse import COARSE

from ia_bench.readers.native import NativeReader
from ia_bench.scenes.scene import Scene

torch.set_num_threads(1)  # the arrays here are small: more threads only wait for each other

FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run"]
FLAGS += ["--disable-component-update", "--disable-sync"]  # of Chromium

TINY = Path(__file__).resolve().parents[1] / "datasets" / "scenes" / "tiny"


@pytest.fixture(scope="session")
def tiny_folder() -> Path:
    """The shipped 32 x 32 scene; read only."""
    return TINY


@pytest.fixture(scope="session")
def tiny() -> Scene:
    """The shipped 32 x 32 scene with its ground truth."""
    return NativeReader(TINY).read(truth=True)


@pytest.fixture
def tiny_copy(tmp_path: Path) -> Path:
    """A copy of `tiny` to break in one place; what it looks like before is checked by the test of the shipped scene."""
    return Path(shutil.copytree(TINY, tmp_path / "tiny"))


@pytest.fixture(scope="session")
def ceiling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the ceiling on `tiny`; read only."""
    from ia_bench.runs.composition import compose
    from ia_bench.runs.execute import execute

    folder = tmp_path_factory.mktemp("runs") / "ceiling"
    execute(compose(["scene=tiny", "method=ceiling", "device=cpu", "threads=1", "seed=3", *COARSE, f"out={folder}"]))
    return folder


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own, in which nothing is at first."""
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where indirect light is baked once for all tests of a file, on an atlas of 32 x 32 texels in place of a score's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IA_BENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr("ia_bench.render.reconstruction.REFERENCE_ATLAS", 32)
        yield


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A real browser, by ``apt-get install chromium`` and the extra ``browser``; without one what needs it is skipped, visibly."""
    sync = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install playwright")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("needs a browser: apt-get install chromium")
    with sync.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield opened
        opened.close()
