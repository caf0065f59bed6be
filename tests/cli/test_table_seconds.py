"""Gains at equal seconds of a real, small table, and what is wrong with a table's curve."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from ia_bench.cli import report, table
from ia_bench.common.errors import InputError
from ia_bench.runs.table import load_table

ROWS = """
rows:
  - {name: none, overrides: [prior=none]}
  - {name: longer, overrides: [prior=none, fit.stage1_steps=48, fit.stage2_steps=24, fit.pixels=2048]}
  - {name: parsimony, overrides: [prior=parsimony]}
"""


def read(path: str) -> list[dict[str, str]]:
    with Path(path).open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_table_of_the_tiny_scene_prints_gains_at_equal_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(f"scenes: [tiny]\nreference: none\ncurve: [longer]\n{ROWS}")
    small = ["preset=smoke", "protocol.map_points=1", "protocol.render_points=1", "device=cpu", "threads=1", "jobs=1"]
    assert table.main(["table=mine.yaml", *small]) == 0
    printed = capfd.readouterr().out
    assert "Seconds are CPU seconds of the runs" in printed
    lines = {one["row"]: one for one in read("results/mine/seconds.csv") if one["metric"] == "aligned_albedo.psnr"}
    assert float(lines["none"]["cost"]) == 1
    assert float(lines["longer"]["cost"]) > 1.2
    runs = {one["row"]: one for one in read("results/mine/runs.csv")}
    gain = float(runs["parsimony"]["aligned_albedo_psnr"]) - float(runs["none"]["aligned_albedo_psnr"])
    assert float(lines["parsimony"]["gain"]) == pytest.approx(gain, abs=1e-5)
    assert float(runs["longer"]["cpu_seconds"]) / float(runs["none"]["cpu_seconds"]) == pytest.approx(
        float(lines["longer"]["cost"])
    )
    assert report.main(["results/mine/runs.csv", "--out", "again", "--reference", "none", "--curve", "longer"]) == 0
    again = sorted(Path("again/seconds.csv").read_text().splitlines())
    assert again == sorted(Path("results/mine/seconds.csv").read_text().splitlines()), "a runs.csv has all that it takes"


def test_a_row_that_is_on_no_table_is_no_curve(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"scenes: [tiny]\nreference: none\ncurve: [loger]\n{ROWS}")
    with pytest.raises(InputError, match="curve: unknown row 'loger'; did you mean 'longer'"):
        load_table(str(path))
