"""The real captures as the table reads them, small: views, exposures, and masks that agree with the poses."""

from pathlib import Path

import pytest

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.render.agreement import check_agreement
from ia_bench.runs.table import load_table

CAPTURES = {entry.name: entry for entry in load_table("captures").entries(None)}
VIEWS = {"banana": 14, "tankard": 69, "gold_cape": 119, "alexander": 53, "head": 66}
RATIOS = {"tankard": 1.3, "gold_cape": 2.0, "alexander": 5.23}  # of the largest to the smallest recorded exposure


IN_TIME = ("banana", "tankard")  # the others take a minute in all


@pytest.mark.parametrize("name", [pytest.param(name, marks=[] if name in IN_TIME else [pytest.mark.slow]) for name in VIEWS])
def test_captures_are_read_and_silhouettes_fit(name: str, real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path))
    entry = CAPTURES[name]
    folder = real_data / Path(entry.path).relative_to("results/real")
    if not folder.is_dir():
        pytest.skip(f"no {folder}: make real-data NC=1")
    scene = NerfstudioReader(folder, shrink=8).read(truth=False)
    assert len(scene.train) + len(scene.test) == VIEWS[name]
    exposures = [view.exposure or 0.0 for view in (*scene.train, *scene.test)]
    assert max(exposures) / min(exposures) == pytest.approx(RATIOS.get(name, 1.0), rel=0.01)
    notes: list[str] = []
    taken = captured(scene, CaptureSettings(geometry="hull", cells=48, tolerated=2), notes.append)
    assert len([note for note in notes if "recorded exposures differ" in note]) == int(name in RATIOS)
    assert all((view.exposure is None) == (name not in RATIOS) for view in taken.test)
    check_agreement(taken, lambda note: None)
