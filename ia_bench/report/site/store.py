"""Lay the pictures that a report's runs have kept beside its page, and those of the truth, which are drawn once."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.report.collect import Runs, finished
from ia_bench.report.write import write_whole
from ia_bench.runs.config import slug
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.pictures import packing
from ia_bench.runs.pictures.drawing import RELIT_STRIDE, VERSION, VIEW_STRIDE, SceneRenderer
from ia_bench.runs.pictures.packing import Bundle, ShownViews, read_bundle, sheets
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Truth

if TYPE_CHECKING:
    from ia_bench.report.site.page import Gallery

LAYOUT = 2
"""Part of what a drawn truth is known by; raised when the page has to know other things of unchanged pictures."""
TRUTH = "truth"
"""The folder of a scene's true pictures."""
KEY = "drawn.json"
"""What a truth that was drawn is known by."""


def lay_out_pictures(gallery: Gallery, runs: Runs, parts: Path, note: Callable[[str], None]) -> None:
    """Picture the first finished run of every row and scene in the folder ``parts``, and what is true beside it.

    ``note`` is told what is being drawn. What cannot be shown (a run without pictures, a scene that is not there or was changed
    since) is named in :attr:`Gallery.missing`: a report is whole without it.
    """
    first: dict[str, dict[str, Path]] = {}
    done = finished(runs).sort_values("seed", kind="stable")
    for row, scene, folder in zip(done["row"], done["scene"], done["folder"], strict=True):
        if (folder / CONFIG).is_file():
            first.setdefault(scene, {}).setdefault(row, folder)
    for scene, folders in first.items():
        try:
            gallery.scenes[scene] = _write_scene(scene, folders, parts / folder_of(scene), gallery.missing, note)
        except InputError as error:
            gallery.missing.append(f"{scene}: {error}")


def folder_of(name: str) -> str:
    """The folder of a scene's or a row's pictures: a name that no other one has, on disks that know no upper case either."""
    return f"{slug(name)}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _write_scene(
    scene: str, rows: dict[str, Path], folder: Path, missing: list[str], note: Callable[[str], None]
) -> dict[str, Any]:
    kept: dict[str, tuple[Recovered, Bundle]] = {}
    for row, path in rows.items():
        try:
            run, own = Recovered(path), read_bundle(path)
            if own is None:
                raise InputError("it has kept no pictures")
            other, its = next(iter(kept.values()), (run, own))
            if _reading(run) != _reading(other):
                raise InputError(f"another reading of the scene than that of {next(iter(kept))}")
            if own.views.fitted != its.views.fitted:
                raise InputError("no view was held out, and it is pictured in other training views")
        except InputError as error:
            missing.append(f"{row}, {scene}: {error}")
        else:
            kept[row] = run, own
    if not kept:
        raise InputError("no run has kept pictures")
    described = _truth(*next(iter(kept.values())), folder / TRUTH, note) | {"rows": {}}
    for row, (run, own) in kept.items():
        place = folder_of(row)
        parts = {"errors": own.errors, "solid": own.solid}
        scripts = {f"{part}.js": packing.script(f"{folder.name}/{place}/{part}", content) for part, content in parts.items()}
        _write(folder / place, scripts | own.sheets)
        described["rows"][row] = {"folder": place, "sheets": own.shapes, "scores": _scores(own.views, run)}
    wanted = {TRUTH, *(one["folder"] for one in described["rows"].values())}
    for left in folder.iterdir():  # of rows that the report no longer has
        if left.name not in wanted and (left / "errors.js").is_file():
            shutil.rmtree(left)
    return described


def _reading(run: Recovered) -> list[Any]:
    """What decides the scene as it is pictured: its files, and how they were read. What a capture leaves out is no truth."""
    return [run.scene_content, asdict(run.config.reader)]


def _truth(run: Recovered, kept: Bundle, folder: Path, note: Callable[[str], None]) -> dict[str, Any]:
    """What the page has to know of photographs and truth, which are drawn into ``folder`` where they are not there yet."""
    fitted, scene_name = kept.views.fitted, folder.parent.name  # training views, where none is held out
    key = hashlib.sha256(json.dumps([VERSION, LAYOUT, *_reading(run), *fitted]).encode()).hexdigest()
    with suppress(InputError):  # none, or a damaged one: drawn anew
        held = read_json(folder / KEY)
        if held.get("key") == key:
            return dict(held["described"])
    note(f"pictures of {run.record.scene}: the truth")
    drawn = SceneRenderer(run.read_scene(whole=True), fitted)
    scene, truth = drawn.scene, drawn.scene.truth or Truth({})
    lights = {name: truth.lights[name] for name in ("train", *drawn.relit) if name in truth.lights}
    maps = {name: packing.light(LatLongEnvironment(torch.from_numpy(map_).float())) for name, map_ in lights.items()}
    content: dict[str, Any] = {"lights": maps}
    if scene.mesh is not None:  # else every run has one of its own
        content["mesh"] = packing.solid(scene.mesh)
        if truth.albedo is not None and truth.roughness is not None:
            content |= packing.textures(truth.albedo, truth.roughness)
    found, shapes = sheets(drawn.truth())
    _write(folder, {"solid.js": packing.script(f"{scene_name}/{TRUTH}/solid", content)} | found)
    names = {
        kind: [f"{view.name}, which was fitted" if view.name in drawn.fitted else view.name for view in views]
        for kind, views in {"albedo": drawn.test, "view": drawn.views}.items()
    }
    described = {
        "folder": scene_name,
        "sheets": shapes,
        "textured": "albedo" in content,
        "lights": [*drawn.relit],
        "relit": [[light, view.name] for light, views in drawn.relit.items() for view in views],
        "views": names,
    }
    _write(folder, {KEY: json.dumps({"key": key, "described": described}, ensure_ascii=False).encode()})
    return described


def _scores(views: ShownViews, run: Recovered) -> dict[str, list[float | None]]:
    """The recorded score of every view that is shown: PSNR, of roughness the squared error."""
    recorded: dict[str, Any] = run.record.per_image

    def of(values: Any, name: str, count: int, stride: int = 1) -> list[float | None]:  # noqa: ANN401 (of a record, by light or not)
        kept = values.get(name) if isinstance(values, dict) else None
        found = kept[::stride] if isinstance(kept, list) else []
        digits = 1 if name == "psnr" else 4
        return [value and round(value, digits) for value in found] if len(found) == count else [None] * count

    relit, test = recorded.get("relighting") or {}, views.test
    return {
        "albedo": of(recorded.get("albedo"), "psnr", test),
        "aligned": of(recorded.get("aligned_albedo"), "psnr", test),
        "roughness": of(recorded.get("roughness"), "mse", test),
        "view": of(recorded.get("view_synthesis"), "psnr", views.view, VIEW_STRIDE),
        "relit": [score for light, count in views.relit.items() for score in of(relit.get(light), "psnr", count, RELIT_STRIDE)],
    }


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """Write ``files`` by name, those without a suffix as sheets of pictures."""
    for name, content in files.items():
        write_whole(folder / (name if "." in name else f"{name}.webp"), content)
