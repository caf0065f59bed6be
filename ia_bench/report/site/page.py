"""The report as a page: one folder with an ``index.html`` that a double click opens, without a server or a network.

Text and numbers are in the HTML, filled from ``templates/``; its scripts have the same as data. Large PARTS beside it load late.
"""

from __future__ import annotations

import gzip
import json
import os
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.settings import flat
from ia_bench.report.collect import HASH_DIGITS, TIMES, Runs, reason_of, setup_of
from ia_bench.report.curves import Curve
from ia_bench.report.findings import Findings
from ia_bench.report.statistics import HOW_JUDGED, Block, Estimate, Line, tally
from ia_bench.report.table import BOUNDS, HEADLINE, ORIGINS, claims_table, estimate_text
from ia_bench.report.worth import maps
from ia_bench.report.write import remove_all_but, write_text
from ia_bench.runs.pictures.packing import compact
from ia_bench.runs.record import RunRecord
from ia_bench.runs.table import Row, crossed_name
from ia_bench.scores.metrics import CURVE_METRICS, METRICS, Metric

INDEX, PARTS = "index.html", "parts"
VIEWER, PICTURES = "model-viewer-umd.min.js", "pictures.js"
KEPT = "pictures.zip"  # of a run folder; runs.pictures.packing, which writes it, brings in torch
VENDORED = ("vendor/uPlot.iife.min.js.gz", "vendor/img-comparison-slider.js")
STYLES = ("vendor/uPlot.min.css", "vendor/img-comparison-slider.css", "assets/page.css", "assets/parts.css")
SCRIPTS: tuple[str, ...] = ("common", "tips", "table", "live", "evidence", "parts", "scales", "curves", "heat", "look")
SCRIPTS += ("relight", "turn", "worth")

DIGITS = 5  # significant ones of a number that a script draws or sorts by
EXACT = 7  # those of a number that a script prints, so that it rounds as the table does
BRIEF = 0.05  # seconds below which a phase is not told
CHECKSUM_DIGITS = 12
MACHINE = ("cpu", "cores", "threads", "device", "system", "python", "commit")
OF_A_RUN = ("seed", "scene.", "out", "row")  # begin settings that every run tells by itself

COMPONENTS = {
    "albedo": "Albedo of the test views against the truth, as it was recovered",
    "aligned_albedo": "Albedo of the test views after one factor for all views and channels has matched its mean to the truth's",
    "view_synthesis": "Photographs from new viewpoints under the training light",
    "relighting": "Photographs under lights that no method has seen, drawn with the aligned albedo",
    "roughness": "Perceptual roughness of the test views, from 0 to 1",
}
"""Component of a metric -> what is compared with what."""
MEASURES = {
    "psnr": "Peak signal-to-noise ratio in dB over the object's pixels, sRGB-encoded, averaged over images",
    "ssim": "Structural similarity, 1 for equal images",
    "lpips": "Perceptual distance by a network, 0 for equal images",
    "mse": "Mean squared error over the object's pixels",
}
"""Name of a metric -> how it is measured."""
COSTS = {
    "seconds": "Baking, prior and fit, without scoring and without the preparation of the scene (its capture, a mesh made for it), "
    "which is the same for every row: mean over scenes and seeds, on the machine that each run names (or as declared)",
    "memory": "The largest resident memory of any of the row's processes",
    "failed": "Runs that ended without scores, of all runs. They enter no mean",
}
"""Key of a cost -> what it counts."""
WHY_THE_PAPER_DIFFERS = (
    "The paper measured on its own scenes, with its own renderer and trained weights, and leaves mask, encoding and alignment "
    "open. Orders may be compared, levels may not."
)


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

    ``text`` is its mean as it is printed, ``value`` what it is sorted by, ``width`` its interval's half width as it is printed,
    ``share`` how much of the way from floor to ceiling it goes, in percent. ``best``: it leads those that do not see the truth, and
    that is decided. ``why`` there is no value, or not for all scenes. ``headline``: shown before somebody asks for everything.
    """

    key: str
    text: str
    value: float | None
    width: str = ""
    share: float | None = None
    best: bool = False
    why: str = ""
    headline: bool = True


def write_page(
    findings: Findings, title: str, folder: Path, gallery: Gallery | None = None, live: dict[str, Any] | None = None
) -> Path:
    """Write the page into ``folder`` and return its index.html; the same runs give the same bytes.

    ``gallery``: the pictures that :func:`draw_pictures` has laid into its folder PARTS. ``live``: what a page that is watched
    has to know, by which "key" its finished cells are known, and "every" how many seconds there are news; None for a report.
    """
    gallery = gallery or Gallery()
    folder.mkdir(parents=True, exist_ok=True)
    data = _data(findings, title, folder, live)
    loader = PackageLoader("ia_bench.report.site")
    templates = Environment(trim_blocks=True, lstrip_blocks=True, autoescape=True, undefined=StrictUndefined, loader=loader)
    text = templates.get_template("page.html.j2").render(
        title=title,
        live=live,
        worth=maps(findings.gains),
        gallery=gallery,
        findings=findings,
        scopes=scopes(findings),
        claims=claims_table(findings.verdicts, findings.scenes),
        origins=ORIGINS,
        tally=tally,
        how_judged=HOW_JUDGED,
        metrics=METRICS,
        rows={row["name"]: row for row in data["rows"]},
        is_headline=is_headline,
        definition=definition,
        costs=COSTS,
        why_the_paper_differs=WHY_THE_PAPER_DIFFERS,
        crossed_name=crossed_name,
        data=_json(data),
        styles=[_part(name) for name in STYLES],
        scripts=[_part(name) for name in (*VENDORED, *(f"assets/{name}.js" for name in SCRIPTS))],
    )
    if gallery.scenes:
        described = f"window.benchPictures={_json(gallery.scenes)};\n".encode()
        for name, part in {VIEWER: _content(f"vendor/{VIEWER}.gz"), PICTURES: described}.items():
            with whole_file(folder / PARTS / name) as partial:
                partial.write_bytes(part)
    else:
        remove_all_but((), (folder / PARTS / name for name in (VIEWER, PICTURES)))
    return write_text(folder / INDEX, re.sub(r"\n\s+(?=<)", "\n", text))  # without the indentation of the templates


def draw_pictures(runs: Runs, parts: Path, note: Callable[[str], None]) -> Gallery:
    """Lay out the pictures that runs have kept, where any has; those of scenes that the report no longer has go."""
    gallery = Gallery()
    if any((folder / KEPT).is_file() for folder in runs["folder"]):
        from ia_bench.report.site.store import write_pictures  # brings in torch

        write_pictures(gallery, runs, parts, note)
    shown = {scene["folder"] for scene in gallery.scenes.values()}
    for marked in list(parts.glob("*/truth/drawn.json")):
        if marked.parents[1].name not in shown:
            shutil.rmtree(marked.parents[1], ignore_errors=True)
    return gallery


def _json(data: dict[str, Any]) -> Markup:
    """JSON that may stand in a script element: whatever texts it holds, none ends the element."""
    return Markup(compact(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


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
    return [(block, [(one, _numbers(one, block)) for one in block.lines]) for block in blocks]


def is_headline(metric: Metric) -> bool:
    """Whether a metric is one of those that a table is read by first."""
    return metric.label in HEADLINE


def definition(metric: Metric) -> str:
    """What a column shows, and which direction is better."""
    better = "Higher" if metric.higher_is_better else "Lower"
    said = MEASURES.get(metric.name) or (metric.of.__doc__ or metric.label).splitlines()[0].rstrip(".")  # of a metric that is new
    return f"{COMPONENTS[metric.component]}. {said}. {better} is better."


def _numbers(one: Line, block: Block) -> list[Number]:
    ends = {BOUNDS[line.row]: line.values for line in block.lines if line.row in BOUNDS}
    numbers = []
    for metric in METRICS:
        value = one.values[metric.key]
        text, _, width = estimate_text(value, metric, block.scenes).partition(" ± ")
        share = _share(value, *(ends.get(name, {}).get(metric.key) for name in ("floor", "ceiling")))
        best, why = block.is_best(one.row, metric), "; ".join(one.reasons[metric.key])
        numbers.append(
            Number(metric.key, text, None if value is None else short(value.mean), width, share, best, why, is_headline(metric))
        )
    seconds, memory = None if one.seconds is None else one.seconds.mean, one.peak_memory_bytes
    return [
        *numbers,
        Number("seconds", "–" if seconds is None else f"{seconds:.1f}{' (declared)' if one.declared else ''}", short(seconds)),
        Number("memory", "–" if memory is None else f"{memory / 2**20:.0f}", short(memory), headline=False),
        Number("failed", f"{one.failed}/{one.runs}", one.failed),
    ]


def _share(value: Estimate | None, floor: Estimate | None, ceiling: Estimate | None) -> float | None:
    if value is None or floor is None or ceiling is None or floor.mean == ceiling.mean:
        return None
    return round(100 * min(max((value.mean - floor.mean) / (ceiling.mean - floor.mean), 0.0), 1.0), 1)


# ---- data for the scripts ---------------------------------------------------------------------------------------------


def _data(findings: Findings, title: str, page: Path, live: dict[str, Any] | None) -> dict[str, Any]:
    """Everything that the page's scripts need, as JSON types. ``page``: the folder that links to run folders start from.

    What many runs have alike, a configuration or a machine, is told once: a run names it by its place.
    """
    once: tuple[dict[str, int], dict[str, int]] = {}, {}
    runs = [_run(run, page, findings, *once) for run in findings.runs.to_dict("records")]
    configurations, machines = ([json.loads(text) for text in places] for places in once)
    own = ("key", "group", "label", "title", "digits")
    return {
        "title": title,
        "protocol": findings.protocol,
        "metrics": [
            {name: getattr(metric, name) for name in own}
            | {"higher": metric.higher_is_better, "headline": is_headline(metric), "definition": definition(metric)}
            for metric in METRICS
        ],
        "curveMetrics": [metric.key for metric in CURVE_METRICS],
        "costs": COSTS,
        "rows": [_row(line, findings) for line in findings.overall.lines],
        "scenes": list(findings.scenes),
        "whyPaper": WHY_THE_PAPER_DIFFERS,
        "configurations": configurations,
        "machines": machines,
        "runs": runs,
        **({} if live is None else {"live": live}),
    }


def _row(line: Line, findings: Findings) -> dict[str, Any]:
    row = next((one for one in findings.table.crossed_rows if one.name == line.row), Row(line.row, []))
    paper = findings.counterparts.get(line.row)
    return {
        "name": line.row,
        "note": row.note,
        "bound": BOUNDS.get(line.row),
        "truth": line.sees_truth,
        "paper": paper and {"method": paper.method, "values": paper.values},
        "command": shlex.join(["ia-bench", "run", *row.overrides]) if row.overrides else "",
    }


def _run(run: dict[str, Any], page: Path, of: Findings, configurations: dict[str, int], machines: dict[str, int]) -> dict[str, Any]:
    found = _evidence(run)
    machine = {**{key: run[key] for key in ("commit", "cpu", "threads") if not pd.isna(run[key])}, **found.pop("machine", {})}
    phases = {name.removeprefix(TIMES): value for name, value in run.items() if name.startswith(TIMES) and value >= BRIEF}
    undefined = [] if run["problem"] is not None else [metric for metric in METRICS if np.isnan(run[metric.column])]
    record = {
        "row": of.rows.index(run["row"]),
        "scene": of.scenes.index(run["scene"]),
        "seed": int(run["seed"]),
        "problem": run["problem"],
        "values": [short(run[metric.column], EXACT) for metric in METRICS],
        "reasons": {metric.key: reason_of(run["reasons"], metric.key) for metric in undefined},
        "seconds": short(run["seconds"]),
        "phases": {name: round(seconds, 1) for name, seconds in phases.items()},
        "memory": None if pd.isna(run["peak_memory_bytes"]) else int(run["peak_memory_bytes"]),
        "hash": run["config_hash"],
        "preset": run["preset"],
        "folder": os.path.relpath(run["folder"], page).replace(os.sep, "/") if found else None,
        "configuration": _place(found.pop("settings", {}), configurations),
        "machine": _place(machine, machines),
        **found,
        "curve": None if run["curve"] is None else curve_data(run["curve"]),
    }
    return {key: value for key, value in record.items() if value is not None and value not in ({}, [], "")}


def _place(entry: dict[str, Any], places: dict[str, int]) -> int | None:
    return places.setdefault(json.dumps(entry), len(places)) if entry else None


def _evidence(run: dict[str, Any]) -> dict[str, Any]:
    """What a run's folder says of how its numbers came about; nothing of a run that only a runs.csv knows.

    ``settings``: its configuration, flat; ``command``: its command line; ``machine``: machine, versions and commit, flat;
    ``files``: name -> the first digits of the SHA-256 of what the run wrote; ``renderer``: who drew the pictures that were scored.
    """
    setup = setup_of(run["folder"])
    try:
        record = RunRecord.read(run["folder"])
    except (InputError, FileNotFoundError):
        return {}
    if setup is None or (record.row != run["row"] and record.config_hash[:HASH_DIGITS] != run["config_hash"]):
        return {}  # the folder may be that of a report, not of this run
    packages = record.environment.get("packages")
    return {
        "settings": {name: value for name, value in flat(setup.config).items() if not name.startswith(OF_A_RUN)},
        "command": setup.command,
        "machine": {key: record.environment[key] for key in MACHINE if record.environment.get(key) is not None}
        | (flat(packages, "packages.") if isinstance(packages, dict) else {}),
        "files": {name: digest[:CHECKSUM_DIGITS] for name, digest in record.files.items()},
        "renderer": record.renderer,
    }


def curve_data(curve: Curve) -> dict[str, Any]:
    """A curve as the page's scripts have it."""
    return {
        "level": curve.is_level,
        "seconds": [short(value) for value in curve.seconds.tolist()],
        "values": [[short(value) for value in curve.values[metric.column].tolist()] for metric in CURVE_METRICS],
    }


def short(value: float | None, digits: int = DIGITS) -> float | None:
    """A number without the digits that nobody sees."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.{digits}g}")
