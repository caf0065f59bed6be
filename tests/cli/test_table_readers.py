"""A table over scenes of two formats, through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from coarse import COARSE

from ia_bench.cli.table import main
from ia_bench.readers.writers.frames import write_nerfstudio
from ia_bench.scenes.scene import Scene

TABLE = """
scenes:
  - tiny
  - {name: their tiny, reader: nerfstudio, path: PATH, options: {held_out: 2}}
rows: [{name: nothing known, overrides: [prior=none]}]
"""


def test_two_readers_make_one_table(tiny: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_nerfstudio(tmp_path / "data" / "capture", tiny)
    Path("mine.yaml").write_text(TABLE.replace("PATH", str(tmp_path / "data" / "capture")))
    few = ["preset=smoke", "fit.stage1_steps=2", "fit.stage2_steps=1", *COARSE]
    assert main(["table=mine.yaml", "jobs=1", "device=cpu", *few]) == 0
    found = pd.read_csv("results/mine/runs.csv").set_index("scene")
    assert list(found.index) == ["tiny", "their tiny"]
    assert found["view_synthesis_psnr"].notna().all()
    assert pd.isna(found["roughness_mse"]["their tiny"]), "photographs have no true roughness"
    (record,) = (json.loads(path.read_text()) for path in Path("results").rglob("runs/their-tiny/*/metrics.json"))
    report = Path("results/mine/report.md").read_text()
    own = report.split("## Scene their tiny")[1].split("\n## ")[0]
    assert f"Left out, for no run has it: Roughness MSE ↓: {record['reasons']['roughness.mse']}" in own, "its column is left out"
    assert "Roughness MSE" in report.split("## Mean over")[1].split("\n## ")[0], "the other scene has it"
    command = json.loads(next(Path("results").rglob("runs/their-tiny/*/config.json")).read_text())["command"]
    assert "reader='nerfstudio'" in command.replace("'\"'\"'", "'")
