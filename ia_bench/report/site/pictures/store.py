"""Lay the pictures of a report's runs beside its page: what runs have kept, else drawn; what lies there already stays."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.report.collect import Runs, finished
from ia_bench.report.site.gallery import KEY, NOT_ROWS, TRUTH, Gallery, folder_names
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.pictures import packing
from ia_bench.runs.pictures.bundle import PICTURES, Bundle, bundle, read_bundle, sheets
from ia_bench.runs.pictures.drawing import RELIT_STRIDE, VERSION, VIEW_STRIDE, Pictures, SceneRenderer
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Truth

LAYOUT = 2
"""Part of what a laid-out folder is known by; raised when the page has to know other things of unchanged pictures."""


def write_pictures(runs: Runs, parts: Path, note: Callable[[str], None]) -> Gallery:
    """Picture the first finished run of every row and scene in the folder ``parts``, and what is true beside it.

    ``note`` is told what is being drawn. What cannot be drawn (a run of no textures, a scene that is not there or was changed
    since) is named in :attr:`Gallery.missing`: a report is whole without it.
    """
    gallery = Gallery()
    first: dict[str, dict[str, Path]] = {}
    done = finished(runs).sort_values("seed", kind="stable")
    for row, scene, folder in zip(done["row"], done["scene"], done["folder"], strict=True):
        if (folder / CONFIG).is_file():
            first.setdefault(scene, {}).setdefault(row, folder)
    places = folder_names(first)
    for scene, folders in first.items():
        try:
            gallery.scenes[scene] = _hang_scene(scene, folders, parts / places[scene], gallery.missing, note)
        except InputError as error:
            gallery.missing.append(f"{scene}: {error}")
    return gallery


def _hang_scene(scene: str, rows: dict[str, Path], folder: Path, missing: list[str], note: Callable[[str], None]) -> dict[str, Any]:
    recovered: dict[str, Recovered] = {}
    kept: dict[str, Bundle | None] = {}
    places = folder_names(rows, NOT_ROWS)
    for row, run in rows.items():
        try:
            if row in NOT_ROWS:
                raise InputError(f"expected a row that is not called as the page calls the {row} itself; row=NAME gives it a name")
            found, kept[row] = Recovered(run), read_bundle(run)
            if kept[row] is None and not (run / "albedo.exr").is_file():
                raise InputError("it has exported no textures")
        except InputError as error:
            missing.append(f"{row}, {scene}: {error}")
        else:
            recovered[row] = found
    if not recovered:
        raise InputError("no run has exported textures")
    reference = next(iter(recovered.values()))
    fitted: list[str] = next((one.views.get("fitted", []) for one in kept.values() if one is not None), [])
    writer = _PictureWriter(reference, fitted, note)
    described = _kept(folder / TRUTH, [*_scene_of(reference), *fitted], writer.write_truth)
    described["rows"] = {}
    for row, run_ in recovered.items():
        if _scene_of(run_) != _scene_of(reference):
            missing.append(f"{row}, {folder.name}: another reading of the scene than that of {next(iter(recovered))}")
            continue
        files = run_.record.files
        names = (PICTURES, *(f"{name}.exr" for name in ("albedo", "roughness", "light")))
        if (own := kept[row]) is not None and own.views.get("fitted", []) != fitted:
            missing.append(f"{row}, {folder.name}: no view was held out, and it is pictured in other training views")
            continue
        known = [*_scene_of(run_), *(files.get(name) for name in names), run_.scale.tolist()]
        try:
            one = dict(_kept(folder / places[row], known, partial(writer.write_row, run_, kept[row])))
            scores = _scores(one.pop("views"), run_)  # how many views there are is told by the scores
            described["rows"][row] = {**one, "scores": scores}
        except InputError as error:
            missing.append(f"{row}, {folder.name}: {error}")
    wanted = {TRUTH, *(one["folder"] for one in described["rows"].values())}
    for place in folder.iterdir():  # of rows that the report no longer has
        if place.name not in wanted and (place / KEY).is_file():
            shutil.rmtree(place)
    return described


class _PictureWriter:
    """One scene while it is drawn: it is read and traced when the first picture is missing, and once.

    ``fitted``: the training views that runs are pictured in, where the scene holds none out.
    """

    def __init__(self, run: Recovered, fitted: Sequence[str], note: Callable[[str], None]) -> None:
        self._run, self._fitted, self._note = run, fitted, note

    @cached_property
    def _scene_renderer(self) -> SceneRenderer:
        return SceneRenderer(self._run.read_scene(whole=True), self._fitted)

    @cached_property
    def _truth(self) -> Pictures:
        return self._scene_renderer.truth()

    def write_truth(self, folder: Path) -> dict[str, Any]:
        """Write photographs and truth into ``folder`` and return what the page has to know of them."""
        self._note(f"pictures of {folder.parent.name}: the truth")
        return _write_truth(self._scene_renderer, self._truth, folder)

    def write_row(self, run: Recovered, kept: Bundle | None, folder: Path) -> dict[str, Any]:
        """The same of a run: what it has ``kept``, else drawn from its textures."""
        if kept is None:
            if run.capture.geometry != "given":
                raise InputError("its mesh is not the scene's, and its folder has no pictures")
            self._note(f"pictures of {folder.parent.name}: {folder.name}")
            kept = bundle(self._scene_renderer, self._truth, run.reconstruction(self._scene_renderer.stage), run.scale)
        return _write_row(kept, folder)


def _scene_of(run: Recovered) -> list[Any]:
    """What decides the scene as it is pictured: its files, and how they were read. What a capture leaves out is no truth."""
    return [run.scene_content, asdict(run.reader)]


def _kept(folder: Path, known: list[Any], write: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """What ``write`` returns, or what it returned when it last wrote into ``folder`` for the same ``known`` content."""
    key = hashlib.sha256(json.dumps([VERSION, LAYOUT, *known]).encode()).hexdigest()
    path = folder / KEY
    with suppress(InputError):  # none, or a damaged one: drawn anew
        held = read_json(path)
        if held.get("key") == key:
            return dict(held["described"])
    folder.mkdir(parents=True, exist_ok=True)
    described = write(folder)
    _write(path, json.dumps({"key": key, "described": described}, ensure_ascii=False).encode())
    return dict(described)


def _write_truth(scene_renderer: SceneRenderer, pictures: Pictures, folder: Path) -> dict[str, Any]:
    scene, truth = scene_renderer.scene, scene_renderer.scene.truth or Truth({})
    lights = {name: truth.lights[name] for name in ("train", *scene_renderer.lights) if name in truth.lights}
    maps = {name: packing.light(LatLongEnvironment(torch.from_numpy(map_).float())) for name, map_ in lights.items()}
    content: dict[str, Any] = {"lights": maps}
    if scene.mesh is not None:  # else every run has one of its own
        content["mesh"] = packing.solid(scene.mesh)
        if truth.albedo is not None and truth.roughness is not None:
            content |= packing.textures(truth.albedo, truth.roughness)
    _write(folder / "solid.js", packing.script(f"{folder.parent.name}/truth/solid", content))
    found, shapes = sheets(pictures)
    _write_sheets(found, folder)
    relit = [[light, view.name] for light, views in scene_renderer.relit.items() for view in views]
    names = {
        kind: [f"{view.name}, which was fitted" if view.name in scene_renderer.fitted else view.name for view in views]
        for kind, views in {"albedo": scene_renderer.test, "view": scene_renderer.views}.items()
    }
    about = {"folder": folder.parent.name, "sheets": shapes, "textured": "albedo" in content}
    return {**about, "lights": scene_renderer.lights, "relit": relit, "views": names}


def _write_row(kept: Bundle, folder: Path) -> dict[str, Any]:
    place = f"{folder.parent.name}/{folder.name}"
    _write(folder / "errors.js", packing.script(f"{place}/errors", kept.errors))
    _write(folder / "solid.js", packing.script(f"{place}/solid", kept.solid))
    _write_sheets(kept.sheets, folder)
    return {"folder": folder.name, "sheets": kept.shapes, "views": kept.views}


def _scores(views: dict[str, Any], run: Recovered) -> dict[str, list[float | None]]:
    """The recorded score of every view that is shown: PSNR, of roughness the squared error."""
    recorded: dict[str, Any] = run.record.per_image

    def of(values: dict[str, Any] | None, name: str, views: int, stride: int) -> list[float | None]:
        found = (values or {}).get(name, [])[::stride]
        return (
            [None if value is None else round(value, 1 if name == "psnr" else 4) for value in found]
            if len(found) == views
            else [None] * views
        )

    relit = recorded.get("relighting") or {}
    by_light = (of(relit.get(light), "psnr", number, RELIT_STRIDE) for light, number in views["relit"].items())
    return {
        "albedo": of(recorded.get("albedo"), "psnr", views["test"], 1),
        "aligned": of(recorded.get("aligned_albedo"), "psnr", views["test"], 1),
        "roughness": of(recorded.get("roughness"), "mse", views["test"], 1),
        "view": of(recorded.get("view_synthesis"), "psnr", views["view"], VIEW_STRIDE),
        "relit": [score for scores in by_light for score in scores],
    }


def _write_sheets(found: dict[str, bytes], folder: Path) -> None:
    for name, sheet in found.items():
        _write(folder / f"{name}.webp", sheet)


def _write(path: Path, content: bytes) -> None:
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
