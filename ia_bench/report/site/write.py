"""Write the page: one folder with index.html, which holds text, numbers, style and scripts, and the parts that load late."""

from __future__ import annotations

import gzip
import re
import shutil
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ia_bench.common.atomic_file import whole_file
from ia_bench.report.collect import Runs
from ia_bench.report.site import content
from ia_bench.report.statistics import HOW_JUDGED, tally
from ia_bench.report.table import ORIGINS, claims_table
from ia_bench.report.texts import remove_all_but, write_text
from ia_bench.runs.pictures.packing import compact
from ia_bench.runs.table import crossed_name
from ia_bench.scores.columns import METRICS

INDEX = "index.html"
PARTS = "parts"
VIEWER = "model-viewer-umd.min.js"
PICTURES = "pictures.js"
KEPT = "pictures.zip"  # of a run folder; runs.pictures.packing, which writes it, brings in torch
STYLES = ("vendor/uPlot.min.css", "vendor/img-comparison-slider.css", "assets/page.css", "assets/parts.css", "assets/print.css")
SCRIPT_NAMES = (
    *("common", "theme", "tips", "table", "live", "copy", "evidence", "levels", "scales", "curves"),
    *("parts", "heat", "look", "relight", "turn", "worth"),
)
SCRIPTS = ("vendor/uPlot.iife.min.js.gz", "vendor/img-comparison-slider.js", *(f"assets/{name}.js" for name in SCRIPT_NAMES))


def write_page(sources: content.Sources, folder: Path, gallery: content.Gallery | None = None) -> Path:
    """Write the page into ``folder`` and return its index.html; the same runs give the same bytes.

    ``gallery``: the pictures that :func:`draw_pictures` has laid into its folder PARTS.
    """
    gallery = gallery or content.Gallery()
    folder.mkdir(parents=True, exist_ok=True)
    text = _page(sources, content.data(sources, folder), gallery)
    if gallery.scenes:
        described = f"window.benchPictures={_json(gallery.scenes)};\n".encode()
        for name, part in {VIEWER: _content(f"vendor/{VIEWER}.gz"), PICTURES: described}.items():
            with whole_file(folder / PARTS / name) as partial:
                partial.write_bytes(part)
    else:
        remove_all_but((), (folder / PARTS / name for name in (VIEWER, PICTURES)))
    return write_text(folder / INDEX, text)


def draw_pictures(runs: Runs, parts: Path, note: Callable[[str], None]) -> content.Gallery:
    """Lay out the pictures that runs have kept, where any has; those of scenes that the report no longer has go."""
    gallery = content.Gallery()
    if any((folder / KEPT).is_file() for folder in runs["folder"]):
        from ia_bench.report.site.store import write_pictures  # brings in torch

        gallery = write_pictures(runs, parts, note)
    shown = {scene["folder"] for scene in gallery.scenes.values()}
    for marked in list(parts.glob("*/truth/drawn.json")):
        if marked.parents[1].name not in shown:
            shutil.rmtree(marked.parents[1], ignore_errors=True)
    return gallery


def _page(sources: content.Sources, data: dict[str, Any], gallery: content.Gallery) -> str:
    loader = PackageLoader("ia_bench.report.site")
    templates = Environment(trim_blocks=True, lstrip_blocks=True, autoescape=True, undefined=StrictUndefined, loader=loader)
    text = templates.get_template("page.html.j2").render(
        sources=sources,
        gallery=gallery,
        findings=sources.findings,
        scopes=content.scopes(sources.findings),
        claims=claims_table(sources.findings.verdicts, sources.findings.scenes),
        origins=ORIGINS,
        tally=tally,
        how_judged=HOW_JUDGED,
        metrics=METRICS,
        rows={row["name"]: row for row in data["rows"]},
        content=content,
        crossed_name=crossed_name,
        data=_json(data),
        styles=[_part(name) for name in STYLES],
        scripts=[_part(name) for name in SCRIPTS],
    )
    return re.sub(r"\n\s+(?=<)", "\n", text)  # the indentation of the templates


def _json(data: dict[str, Any]) -> Markup:
    """JSON that may stand in a script element: whatever texts it holds, none ends the element."""
    return Markup(compact(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def _part(name: str) -> Markup:
    return Markup(_content(name).decode().replace("</script", "<\\/script"))


def _content(name: str) -> bytes:
    """The bytes of a resource; what is large is kept compressed."""
    found = resources.files("ia_bench.report.site").joinpath(name).read_bytes()
    return gzip.decompress(found) if name.endswith(".gz") else found
