"""How long the page of a whole table takes, and how large it is: ``python -m benchmarks.report_page RUN [--rows 19 --seeds 3]``.

RUN is the folder of one finished run on a shipped scene. It is laid out again under the names of a table's cells, one scene, and
the report is made twice into an empty folder: with the pictures that runs keep, and without them, so that they are drawn. What the
truth of one scene takes is told apart: a table has as many as it has scenes. Seconds are those of the processor.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli.report import main as report
from ia_bench.runs.pictures.bundle import PICTURES


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the seconds, and the size of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--rows", type=int, default=19)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--drawn", type=int, default=2, help="rows of the second report, whose pictures are drawn")
    wanted = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        for name, rows, seeds, kept in (("kept", wanted.rows, wanted.seeds, True), ("drawn", wanted.drawn, 1, False)):
            runs, out = Path(temporary, name, "runs"), Path(temporary, name, "out")
            for place in range(rows):
                for seed in range(seeds):
                    _lay_out(wanted.run, runs / f"{place}-{seed}", f"row {place}", seed, kept=kept)
            started = time.process_time()
            if report([str(runs), "--out", str(out)]):
                return 1
            seconds = time.process_time() - started
            size = sum(path.stat().st_size for path in (out / "page").rglob("*") if path.is_file())
            started = time.process_time()
            report([str(runs), "--out", str(out)])
            again = time.process_time() - started
            print(f"{name}: {rows} rows x {seeds} seeds: {seconds:.1f} s, again {again:.1f} s, page {size / 1e6:.2f} MB")
    return 0


def _lay_out(run: Path, folder: Path, row: str, seed: int, *, kept: bool) -> None:
    """The same run under another name: large files as links, its record with the new name."""
    folder.mkdir(parents=True)
    for path in run.iterdir():
        if path.name != "metrics.json" and (kept or path.name != PICTURES):
            shutil.copyfile(path, folder / path.name) if path.suffix in (".csv", ".json") else (folder / path.name).symlink_to(
                path.resolve()
            )
    record = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    (folder / "metrics.json").write_text(json.dumps(record | {"row": row, "seed": seed}), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
