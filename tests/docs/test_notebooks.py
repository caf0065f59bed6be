"""The notebooks run from top to bottom, in an empty folder, as they stand. Jupyter itself is not needed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from ia_bench.cli.report import main

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
WRITE = "%%writefile "


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IA_BENCH_DATASETS", str(ROOT / "datasets"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    notebook = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, object] = {"__name__": "__main__"}
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert cells
    for cell in cells:
        first, _, rest = cell.partition("\n")
        if first.startswith(WRITE):
            Path(first.removeprefix(WRITE)).write_text(rest, encoding="utf-8")
        else:
            exec(compile(cell, str(path), "exec"), names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_with_small_outputs(path: Path) -> None:
    """As ``make notebooks`` leaves it: every cell run once in its order, nothing raised, no path of a machine."""
    assert path.stat().st_size < 200_000
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert outputs
    assert not [output for output in outputs if output["output_type"] == "error" or output.get("name") == "stderr"]
    assert str(ROOT) not in json.dumps(outputs)


@pytest.mark.parametrize(
    ("measured", "shown", "said"),
    [
        (("view_synthesis",), {"view_synthesis.psnr": 3.0}, "no truth for aligned_albedo.psnr, relighting.psnr, roughness.mse:"),
        (("view_synthesis", "relighting"), {"relighting.psnr": 3.0}, "no truth for aligned_albedo.psnr, roughness.mse:"),
        (
            ("view_synthesis", "relighting", "aligned_albedo", "roughness"),
            {"aligned_albedo.psnr": 3.0, "relighting.psnr": 3.0, "roughness.mse": 3.0},
            "",
        ),
    ],
)
def test_worth_shows_what_a_capture_without_truth_has(
    measured: tuple[str, ...],
    shown: Mapping[str, float],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The last cell, after a report of two rows that are 3 apart in whatever was measured."""
    monkeypatch.chdir(tmp_path)
    for row, level in (("none", 20.0), ("regressor", 23.0)):
        for seed in (0, 1):
            folder = tmp_path / "runs" / f"{row}-{seed}"
            folder.mkdir(parents=True)
            (folder / "metrics.json").write_text(json.dumps(record(row, seed, {name: level for name in measured})))
    assert main(["runs", "--out", "report", "--reference", "none"]) == 0
    capsys.readouterr()
    cells = json.loads((ROOT / "examples" / "notebooks" / "worth.ipynb").read_text(encoding="utf-8"))["cells"]
    last = "".join([cell["source"] for cell in cells if cell["cell_type"] == "code"][-1])
    *before, table = last.splitlines()
    names: dict[str, Any] = {}
    exec("\n".join(before), names)
    found = eval(table, names)
    assert found["difference"].to_dict() == pytest.approx(dict(shown))
    assert found["pairs"].tolist() == [2] * len(shown)
    told = capsys.readouterr().out
    assert said in told
    assert bool(told) == bool(said)


def record(row: str, seed: int, values: Mapping[str, float]) -> dict[str, Any]:
    """The metrics.json of a run, None for what ``values`` has no number of."""
    names = ("albedo", "aligned_albedo", "view_synthesis", "relighting")
    metrics: dict[str, Any] = {name: dict.fromkeys(("psnr", "ssim", "lpips"), values.get(name)) for name in names}
    about = {"schema": 2, "row": row, "scene": "mine", "seed": seed, "protocol": "paper-v2", "config_hash": "0", "status": "ok"}
    costs = {"time_s": {"bake": 1.0, "total": 2.0}, "peak_memory_bytes": 1, "rays": 1, "network_calls": 0, "sees_truth": False}
    rest = {"per_image": {}, "plan": {}, "environment": {}, "files": {}, "protocol_description": {"lpips": {"net": "squeeze"}}}
    metrics["roughness"] = {"mse": values.get("roughness")}
    reasons = {f"{name}.{key}": "no truth" for name, found in metrics.items() for key, value in found.items() if value is None}
    return {**about, **costs, **rest, "metrics": metrics, "reasons": reasons}
