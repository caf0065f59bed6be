"""The page while runs go on: what it is told every few seconds, as a script that it loads again and again.

A page from disk may load scripts, but no data, so the news are a script. What has finished is on the page itself, which is
written again when a cell ends, and loads itself again when the news are of a newer page than itself.
"""

from __future__ import annotations

import hashlib
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.report.collect import collect
from ia_bench.report.curves import read_curve
from ia_bench.report.findings import Findings, analyse
from ia_bench.report.site.data import curve_data
from ia_bench.report.write import write_text
from ia_bench.runs.cells import FAILED, FINISHED, RUNNING, CellStatus, Overview
from ia_bench.runs.folder import CURVE
from ia_bench.runs.pictures.packing import compact
from ia_bench.runs.table import Table


def key_of(overview: Overview) -> str:
    """What a page of the finished and the failed cells is known by."""
    ended = [f"{one.cell.folder.name} {one.written}" for one in overview.of(FINISHED, FAILED)]
    return hashlib.sha256("\n".join(ended).encode()).hexdigest()[:12]


def findings_so_far(overview: Overview, table: Table) -> Findings:
    """What the cells that have ended say; rows and scenes of those that have not are there, empty.

    Raises InputError where two run folders hold the same cell.
    """
    cells = [one.cell for one in overview.cells]
    rows, scenes = (list(dict.fromkeys(names)) for names in ([cell.row for cell in cells], [cell.scene for cell in cells]))
    collection = collect({one.cell.folder: (one.cell.row, one.cell.scene, one.cell.seed) for one in overview.of(FINISHED, FAILED)})
    return analyse(collection, replace(table, scenes=[*scenes]), rows)


def write_news(parts: Path, overview: Overview, every: float, *, ended: bool = False) -> None:
    """Write the news into a page's folder of parts. ``ended``: nobody will write any more."""
    left = overview.seconds_left()
    news = {
        "key": key_of(overview),
        "every": every,
        "made": round(time.time(), 1),
        "ended": ended,
        "left": left and round(left),
        "cells": [
            [one.cell.row, one.cell.scene, one.cell.seed, one.state, one.seconds and round(one.seconds), one.says]
            for one in overview.cells
        ],
        "curves": [
            {"row": one.cell.row, "scene": one.cell.scene, **curve} for one in overview.of(RUNNING) for curve in _curves(one)
        ],
    }
    write_text(parts / "live.js", f"bench.news({compact(news)});\n")


def _curves(one: CellStatus) -> list[dict[str, Any]]:
    with suppress(InputError):  # it says so itself once it has finished
        if (curve := read_curve(one.cell.folder / CURVE)) is not None:
            return [curve_data(curve)]
    return []
