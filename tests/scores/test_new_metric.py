"""The walk of a stranger who adds a metric: a function in metrics.py and a line in columns.py, and no other file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from ia_bench.common.paths import PACKAGE

FUNCTION = '''

def absolute_error(pair: Compared) -> float:
    """Mean of |predicted - true| over the area's pixels."""
    return float(np.abs(pair.predicted - pair.true)[pair.area].mean())
'''
LINE = '    Metric("roughness", "mae", absolute_error, "Roughness", "MAE", higher_is_better=False, digits=3, on_curve=True),\n'
USE = """
import json
import numpy as np
from ia_bench.runs.record import RunRecord
from ia_bench.scenes.images import Images
from ia_bench.scores.evaluate import score, score_quick
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.protocol import Protocol
guess, true = (Predictions(roughness=Images((np.full((4, 5), value),), (np.ones((4, 5)),))) for value in (0.5, 0.25))
scores = score(guess, true, Protocol())
labels = dict(row="a", scene="b", seed=0, config_hash="c", status="ok")
record = RunRecord(**labels, **scores.as_dict())
assert json.loads(record.as_json())["metrics"]["roughness"] == {"mse": 0.0625, "mae": 0.25}
assert record.per_image["roughness"]["mae"] == [0.25]
assert score_quick(guess, true, Protocol())["roughness_mae"] == 0.25
"""


def test_a_new_metric_is_one_function_and_one_line(tmp_path: Path) -> None:
    copy = tmp_path / "ia_bench"
    for file in PACKAGE.rglob("*.py"):
        place = copy / file.relative_to(PACKAGE)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(file)
    for name, change in {
        "metrics.py": lambda text: text + FUNCTION,
        "columns.py": lambda text: text.replace("import Compared, ", "import Compared, absolute_error, ").replace(
            "METRICS = (\n", "METRICS = (\n" + LINE
        ),
    }.items():
        changed = change((PACKAGE / "scores" / name).read_text())
        (copy / "scores" / name).unlink()
        (copy / "scores" / name).write_text(changed)
    done = subprocess.run([sys.executable, "-c", USE], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
