"""The report as a page: one folder with an ``index.html`` that a double click opens, without a server or a network.

Text and numbers are in the HTML, filled from ``templates/``; its scripts have the same as data. Large PARTS beside it load late.
"""

from __future__ import annotations

import gzip
import hashlib
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ia_bench.common.errors import InputError
from ia_bench.common.files import compact_json
from ia_bench.report import statistics
from ia_bench.report import table as tables
from ia_bench.report.blocks import Block, Line
from ia_bench.report.collect import Runs, collect
from ia_bench.report.curves import read_curve
from ia_bench.report.findings import Findings, analyse
from ia_bench.report.seconds import BEYOND, WORTH_METRICS
from ia_bench.report.site import data
from ia_bench.report.statistics import Estimate, Paired
from ia_bench.report.table import BOUNDS, difference_text, estimate_text, seconds_text
from ia_bench.report.worth import maps
from ia_bench.report.write import remove_all_but, write_whole
from ia_bench.runs.cells import FAILED, FINISHED, RUNNING, Overview
from ia_bench.runs.folder import CURVE
from ia_bench.runs.table import Table, crossed_name

INDEX, PARTS = "index.html", "parts"
VIEWER, PICTURES = "model-viewer-umd.min.js", "pictures.js"
PICTURES_FILE = "pictures.zip"  # of a run folder; runs.pictures.packing, which writes it, brings in torch
VENDORED = ("vendor/uPlot.iife.min.js.gz", "vendor/img-comparison-slider.js")
STYLES = ("vendor/uPlot.min.css", "vendor/img-comparison-slider.css", "assets/page.css", "assets/parts.css")
SCRIPTS: tuple[str, ...] = ("common", "tips", "table", "live", "evidence", "parts", "scales", "curves", "heat", "look")
SCRIPTS += ("relight", "turn", "worth", "pareto")


@dataclass
class Gallery:
    """The pictures of a page: plain data, so that a page without any needs no renderer.

    ``scenes``: scene -> what the page has to know to show its pictures (JSON types); ``missing``: a sentence for each scene or row
    that has none.
    """

    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    @property
    def relit(self) -> bool:
        """Whether any scene has a light that no method has seen."""
        return any(scene["lights"] for scene in self.scenes.values())


@dataclass(frozen=True)
class Number:
    """One entry of the table, of the metric or the cost ``key``.

    ``text`` is its mean as it is printed, ``value`` what it is sorted by, ``width`` its intervals' half widths as they are printed,
    ``share`` how much of the way from floor to ceiling it goes, in percent. ``best``: it leads those that do not see the truth, and
    that is decided. ``why`` there is no value, or not for all scenes. ``headline``: shown before somebody asks for everything.
    ``whole``: the PSNR over whole images.
    """

    key: str
    text: str
    value: float | None
    width: str = ""
    share: float | None = None
    best: bool = False
    why: str = ""
    headline: bool = True
    whole: str = ""


def write_page(
    findings: Findings, title: str, folder: Path, gallery: Gallery | None = None, live: dict[str, Any] | None = None
) -> Path:
    """Write the page into ``folder`` and return its index.html; the same runs give the same bytes.

    ``gallery``: the pictures that :func:`draw_pictures` has laid into its folder PARTS. ``live``: what a page that is watched
    has to know, by which "key" its finished cells are known, and "every" how many seconds there are news; None for a report.
    """
    gallery = gallery or Gallery()
    found = data.page_data(findings, title, folder, live)
    loader = PackageLoader("ia_bench.report.site")
    templates = Environment(trim_blocks=True, lstrip_blocks=True, autoescape=True, undefined=StrictUndefined, loader=loader)
    text = templates.get_template("page.html.j2").render(
        title=title,
        live=live,
        gallery=gallery,
        findings=findings,
        worth=maps(findings.gains),
        scopes=scopes(findings),
        metrics=data.shown(findings),
        rows={row["name"]: row for row in found["rows"]},
        crossed_name=crossed_name,
        table=tables,
        statistics=statistics,
        words=data,
        data=_json(found),
        styles=[_part(name) for name in STYLES],
        scripts=[_part(name) for name in (*VENDORED, *(f"assets/{name}.js" for name in SCRIPTS))],
    )
    if gallery.scenes:
        write_whole(folder / PARTS / VIEWER, _content(f"vendor/{VIEWER}.gz"))
        write_whole(folder / PARTS / PICTURES, f"window.benchPictures={_json(gallery.scenes)};\n")
    else:
        remove_all_but((), (folder / PARTS / name for name in (VIEWER, PICTURES)))
    return write_whole(folder / INDEX, re.sub(r"\n\s+(?=<)", "\n", text))  # without the indentation of the templates


def draw_pictures(runs: Runs, parts: Path, note: Callable[[str], None]) -> Gallery:
    """Lay out the pictures that runs have kept, where any has; those of scenes that the report no longer has go."""
    gallery = Gallery()
    if any((folder / PICTURES_FILE).is_file() for folder in runs["folder"]):
        from ia_bench.report.site.store import lay_out_pictures  # brings in torch

        lay_out_pictures(gallery, runs, parts, note)
    shown = {scene["folder"] for scene in gallery.scenes.values()}
    for marked in list(parts.glob("*/truth/drawn.json")):
        if marked.parents[1].name not in shown:
            shutil.rmtree(marked.parents[1], ignore_errors=True)
    return gallery


def _json(data: dict[str, Any]) -> Markup:
    """JSON that may stand in a script element: whatever texts it holds, none ends the element."""
    return Markup(compact_json(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def _part(name: str) -> Markup:
    return Markup(_content(name).decode().replace("</script", "<\\/script"))


def _content(name: str) -> bytes:
    """The bytes of a resource; what is large is kept compressed."""
    found = resources.files("ia_bench.report.site").joinpath(name).read_bytes()
    return gzip.decompress(found) if name.endswith(".gz") else found


# ---- numbers for the templates ----------------------------------------------------------------------------------------


def scopes(findings: Findings) -> list[tuple[Block, list[tuple[Line, list[Number]]]]]:
    """The mean over scenes, where there are several, then every scene: each with a line of numbers for every row."""
    blocks = [*([findings.overall] if len(findings.scenes) > 1 else []), *findings.blocks]
    return [(block, [(one, _numbers(one, block, findings)) for one in block.lines]) for block in blocks]


def _gains(row: str, block: Block, findings: Findings) -> list[Number]:
    """What a row gains over its reference, and at equal seconds; nothing where no row is compared with one."""
    if findings.timing is None:
        return []
    references = [clock.reference for clock in findings.timing.clocks]
    one, numbers = None if row in references else findings.timing.gains[WORTH_METRICS[0]].get(row), []
    for key in ("gain", "equal"):
        pairs = Paired({}) if one is None else getattr(one, key)
        pairs = pairs if block is findings.overall else pairs.of_scene(block.title)
        text, _, width = difference_text(pairs, WORTH_METRICS[0], block.scenes).partition(" ± ")
        late = f" {BEYOND}" if key == "equal" and pairs.count and one and one.beyond else ""
        numbers.append(Number(key, text + late, data.short(mean.mean if (mean := pairs.over_seeds) else None), width))
    return numbers


def _numbers(one: Line, block: Block, findings: Findings) -> list[Number]:
    ends = {BOUNDS[line.row]: line.values for line in block.lines if line.row in BOUNDS}
    numbers = []
    for metric in data.shown(findings):
        value, whole = one.values[metric.key], one.whole.get(metric.key)
        text, _, width = estimate_text(value, metric, block.scenes).partition(" ± ")
        numbers.append(
            Number(
                metric.key,
                text,
                None if value is None else data.short(value.mean),
                width,
                share=_share(block.scenes, value, *(ends.get(name, {}).get(metric.key) for name in ("floor", "ceiling"))),
                best=block.is_best(one.row, metric),
                why="; ".join(one.reasons[metric.key]),
                headline=data.is_headline(metric),
                whole="" if whole is None else metric.text(whole.mean),
            )
        )
    seconds, memory = None if one.seconds is None else one.seconds.mean, one.peak_memory_bytes
    return [
        *numbers,
        *_gains(one.row, block, findings),
        Number("seconds", seconds_text(one, block.scenes), data.short(seconds)),
        Number("memory", "–" if memory is None else f"{memory / 2**20:.0f}", data.short(memory), headline=False),
        Number("failed", f"{one.failed}/{one.runs}", one.failed),
    ]


def _share(scenes: int, value: Estimate | None, floor: Estimate | None, ceiling: Estimate | None) -> float | None:
    """Where a mean lies between floor and ceiling, in percent; None where one is missing, or is over other scenes."""
    if value is None or floor is None or ceiling is None or floor.mean == ceiling.mean:
        return None
    if {value.scenes, floor.scenes, ceiling.scenes} != {scenes}:
        return None
    return round(100 * min(max((value.mean - floor.mean) / (ceiling.mean - floor.mean), 0.0), 1.0), 1)


# ---- the page while runs go on --------------------------------------------------------------------------------------------
# A page from disk may load scripts, but no data: so every few seconds it loads the news as a script. What has finished is on the
# page itself, which is written again when a cell ends, and loads itself again when the news are of a newer page than itself.


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
    left, curves = overview.seconds_left(), []
    for one in overview.of(RUNNING):
        with suppress(InputError):  # it says so itself once it has finished
            if (curve := read_curve(one.cell.folder / CURVE)) is not None:
                curves.append({"row": one.cell.row, "scene": one.cell.scene, **data.curve_data(curve)})
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
        "curves": curves,
    }
    write_whole(parts / "live.js", f"bench.news({compact_json(news)});\n")
