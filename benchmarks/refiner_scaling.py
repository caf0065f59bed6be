"""What the refiner gains by the hours that it costs: a straight line over the logarithm of core-hours, and what more would bring.

    python benchmarks/refiner_scaling.py RUN... [--fit-seconds 7] [--to 40]

Runs are folders of ``python -m ia_bench_training.train_refiner`` with the same held-out fits and other numbers of fits
(``fits=``). Of each the validation with the least error is taken, for with few fits a network becomes worse again. Prints fits,
core-hours (of the fits, at ``--fit-seconds`` of a core each, and of the training until then) and what the network gains on
held-out fits; then the gain that every doubling brings, ± its standard error, and the line at ``--to`` core-hours with its 95 %
interval.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import linregress, t

GAINS = (
    ("2 to 8 photographs, dB", "few_fit", "few_refined", 1.0),
    ("more, dB", "many_fit", "many_refined", 1.0),
    ("2 to 8, roughness", "few_fit_roughness", "few_refined_roughness", -1.0),
    ("more, roughness", "many_fit_roughness", "many_refined_roughness", -1.0),
)
"""Name, figures of the fit and of what the network makes of it, and the sign by which more is better."""


def best(run: Path, fit_seconds: float) -> tuple[int, float, list[float]]:
    """Fits, core-hours and GAINS of the best validation of a ``run``."""
    fits = json.loads((run / "weights" / "refiner.json").read_text())["provenance"]["fits"]
    lines = [json.loads(line) for line in (run / "validation.jsonl").read_text().splitlines()]
    chosen = max(lines, key=lambda line: line["few_refined"] + line["many_refined"])
    gains = [sign * (chosen[after] - chosen[before]) for _, before, after, sign in GAINS]
    return fits, (fits * fit_seconds + chosen["seconds"]) / 3600, gains


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="folders of runs of ia_bench_training.train_refiner; three or more")
    parser.add_argument("--fit-seconds", type=float, default=7, help="of a core, for a fit")
    parser.add_argument("--to", type=float, default=40, help="core-hours to extrapolate to")
    arguments = parser.parse_args()
    if len(arguments.runs) < 3:
        parser.error(f"expected three or more runs, found {len(arguments.runs)}")
    for run in arguments.runs:
        if not (run / "weights" / "refiner.json").exists():
            parser.error(f"{run}: expected a run of ia_bench_training.train_refiner, found no weights/refiner.json in it")
    rows = sorted(best(run, arguments.fit_seconds) for run in arguments.runs)
    print("| fits | core-hours | " + " | ".join(name for name, *_ in GAINS) + " |\n| ---: | ---: |" + " ---: |" * len(GAINS))
    for fits, hours, gains in rows:
        print(f"| {fits} | {hours:.2f} | " + " | ".join(f"{gain:+.3f}" for gain in gains) + " |")
    x, ahead = np.log2([hours for _, hours, _ in rows]), np.log2(arguments.to)
    print(f"\n| gain | a doubling | at {arguments.to:g} core-hours |\n| :--- | ---: | ---: |")
    for (name, *_), y in zip(GAINS, np.array([gains for *_, gains in rows]).T, strict=True):
        line = linregress(x, y)
        left = y - line.intercept - line.slope * x
        spread = np.sqrt(left @ left / (len(x) - 2) * (1 + 1 / len(x) + (ahead - x.mean()) ** 2 / ((x - x.mean()) ** 2).sum()))
        width, there = t.ppf(0.975, len(x) - 2) * spread, line.intercept + line.slope * ahead
        print(f"| {name} | {line.slope:+.3f} ± {line.stderr:.3f} | {there:+.2f} ({there - width:+.2f} to {there + width:+.2f}) |")


if __name__ == "__main__":
    main()
