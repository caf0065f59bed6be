"""What is behind a run that fails: a plugin is named, nothing that it does ends the process with a status of its own."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path

import pytest

from ia_bench.cli.run import main
from ia_bench.methods.contract import Monitor
from ia_bench.methods.validation import reconstruct

PLUGIN = """
import sys
from dataclasses import dataclass
from ia_bench.methods.info import MethodInfo

@dataclass
class Nothing:
    pass

class Shaky:
    Options, presets, info = Nothing, {}, MethodInfo(uses_prior=False)

    def __init__(self, options):
        pass

class Raises(Shaky):
    def fit(self, problem, *, seed, monitor):
        raise KeyError("no such view")

class Leaves(Shaky):
    def fit(self, problem, *, seed, monitor):
        sys.exit(0)

class Unspeakable(Shaky):
    def fit(self, problem, *, seed, monitor):
        raise RuntimeError("a lone \\udc80")
"""


@pytest.fixture
def outcome(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    """Exit status, stderr and record of a run whose method is ``shaky_plugin:NAME``."""
    (tmp_path / "shaky_plugin.py").write_text(PLUGIN)
    (tmp_path / "scene").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ia_bench"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def run(config, folder, progress, known):
        module, _, name = config.method.target.partition(":")
        reconstruct(config.method.name, getattr(__import__(module), name)(None), None, seed=0, monitor=Monitor.silent())

    fake = types.ModuleType("ia_bench.runs.run")
    fake.run = run  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ia_bench.runs.run", fake)

    def call(name: str) -> tuple[int, str, dict]:
        out = tmp_path / "out"
        given = [f"method=shaky_plugin:{name}", f"scene.path={tmp_path / 'scene'}", f"out={out}", "device=cpu", "threads=1"]
        status = main(given)
        return status, capfd.readouterr().err, json.loads((out / "metrics.json").read_text())

    return call


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Raises", "KeyError: 'no such view'"),
        ("Leaves", "SystemExit: 0"),
        ("Unspeakable", r"RuntimeError: a lone \udc80"),
    ],
)
def test_a_plugin_that_fails_is_named_in_one_line(outcome, name: str, message: str) -> None:
    status, said, record = outcome(name)
    assert status == 1
    assert said.splitlines()[-1].startswith(f"ia_bench: method shaky_plugin:{name} raised {message} (")
    assert "Traceback" not in said
    assert record["status"] == "failed"
    assert record["error"].startswith(f"method shaky_plugin:{name} raised {message} (")
    assert "shaky_plugin.py" in record["traceback"]
