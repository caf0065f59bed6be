"""A place in which the command line is called."""

import importlib.util
import os
import sys
from pathlib import Path

import pytest
from command_line import HERE


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder, two scenes, and the fake run in this process and in those it starts."""
    for scene in ("hat", "ship", "console", "figurine"):
        (tmp_path / "datasets" / "scenes" / scene).mkdir(parents=True)
    monkeypatch.setenv("IA_BENCH_DATASETS", str(tmp_path / "datasets"))
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE / "fake_run"), str(HERE.parents[1])]))
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")  # main sets it; this puts it back afterwards
    monkeypatch.delenv("IA_BENCH_DEBUG", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setitem(sys.modules, "ia_bench.runs.run", sys)  # recorded, so that what install() does is undone
    monkeypatch.setattr(sys, "argv", ["ia_bench"])
    spec = importlib.util.spec_from_file_location("fake_run", HERE / "fake_run" / "sitecustomize.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work
