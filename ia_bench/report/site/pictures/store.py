"""Draw a report's runs and lay the pictures beside its page; what lies there already, of the same runs, is not drawn again."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.report.collect import Run
from ia_bench.report.site.gallery import Gallery
from ia_bench.report.site.pictures import packing, solid
from ia_bench.report.site.pictures.drawing import RELIT_STRIDE, VERSION, VIEW_STRIDE, Easel, Pictures
from ia_bench.runs.config import slug
from ia_bench.runs.folder import CONFIG
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.exr import read_exr

KEY = "drawn.json"
TRUTH = "truth"
COMPARED = {"albedo": "albedo", "aligned": "albedo", "roughness": "roughness", "view": "view", "relit": "relit"}
"""What is compared with the truth -> under which name the truth has it."""


def hang(runs: Sequence[Run], parts: Path, note: Callable[[str], None]) -> Gallery:
    """Draw the first finished run of every row and scene into the folder ``parts``, and what is true beside it.

    ``note`` is told what is being drawn. What cannot be drawn (a run of no textures, a scene that is not there or was changed
    since) is named in :attr:`Gallery.missing`: a report is whole without it.
    """
    gallery = Gallery()
    first: dict[str, dict[str, Run]] = {}
    finished = [run for run in runs if run.problem is None and (run.folder / CONFIG).is_file()]
    for run in sorted(finished, key=lambda run: run.seed):
        first.setdefault(run.scene, {}).setdefault(run.row, run)
    for scene, rows in first.items():
        try:
            gallery.scenes[scene] = _hang_scene(rows, parts / slug(scene), gallery.missing, note)
        except InputError as error:
            gallery.missing.append(f"{scene}: {error}")
    return gallery


def _hang_scene(rows: dict[str, Run], folder: Path, missing: list[str], note: Callable[[str], None]) -> dict[str, Any]:
    recovered: dict[str, Recovered] = {}
    for row, run in rows.items():
        try:
            found = Recovered(run.folder)
            if not (run.folder / "albedo.exr").is_file():
                raise InputError("it has exported no textures")
        except InputError as error:
            missing.append(f"{row}, {run.scene}: {error}")
        else:
            recovered[row] = found
    if not recovered:
        raise InputError("no run has exported textures")
    reference = next(iter(recovered.values()))
    wall = _Wall(reference, note)
    described = _kept(folder / TRUTH, _scene_of(reference), wall.write_truth)
    described["rows"] = {}
    for row, run_ in recovered.items():
        if _scene_of(run_) != _scene_of(reference):
            missing.append(f"{row}, {folder.name}: another reading or capture of the scene than that of {next(iter(recovered))}")
            continue
        files = run_.metrics.get("files", dict)
        known = [*_scene_of(run_), *(files.get(f"{name}.exr") for name in ("albedo", "roughness", "light")), run_.scale.tolist()]
        try:
            described["rows"][row] = _kept(folder / slug(row), known, partial(wall.write_row, run_))
        except InputError as error:
            missing.append(f"{row}, {folder.name}: {error}")
    wanted = {TRUTH, *(one["folder"] for one in described["rows"].values())}
    for place in folder.iterdir():  # of rows that the report no longer has
        if place.name not in wanted and (place / KEY).is_file():
            shutil.rmtree(place)
    return described


class _Wall:
    """One scene while it is drawn: it is read and traced when the first picture is missing, and once."""

    def __init__(self, run: Recovered, note: Callable[[str], None]) -> None:
        self._run, self._note = run, note

    @cached_property
    def _easel(self) -> Easel:
        return Easel(self._run.read_scene())

    @cached_property
    def _truth(self) -> Pictures:
        return self._easel.truth()

    def write_truth(self, folder: Path) -> dict[str, Any]:
        """Write the truth into ``folder`` and return what the page has to know of it."""
        self._note(f"pictures of {folder.parent.name}: the truth")
        return _write_truth(self._easel, self._truth, folder)

    def write_row(self, run: Recovered, folder: Path) -> dict[str, Any]:
        """The same of a run."""
        self._note(f"pictures of {folder.parent.name}: {folder.name}")
        return _write_row(self._easel, self._truth, run, folder)


def _scene_of(run: Recovered) -> list[Any]:
    """What decides the scene as a run is pictured: its files, how they were read, and its mesh where the capture made that."""
    capture = run.config.get("config", dict).get("capture", {})
    made = capture if capture.get("geometry", "given") != "given" else {}
    return [run.config.get("config.scene.content", str), asdict(run.reader), made]


def _kept(folder: Path, known: list[Any], write: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """What ``write`` returns, or what it returned when it last wrote into ``folder`` for the same ``known`` content."""
    key = hashlib.sha256(json.dumps([VERSION, *known]).encode()).hexdigest()
    path = folder / KEY
    if path.is_file():
        held: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if held.get("key") == key:
            return dict(held["described"])
    folder.mkdir(parents=True, exist_ok=True)
    described = write(folder)
    _write(path, json.dumps({"key": key, "described": described}, ensure_ascii=False).encode())
    return dict(described)


def _write_truth(easel: Easel, pictures: Pictures, folder: Path) -> dict[str, Any]:
    scene = easel.scene
    assert scene.truth is not None
    lights = {name: scene.truth.lights[name] for name in ("train", *easel.lights)}
    content: dict[str, Any] = {
        "mesh": solid.solid(scene.expect_mesh()),
        "lights": {name: solid.light(LatLongEnvironment(torch.from_numpy(map_).float())) for name, map_ in lights.items()},
    }
    if scene.truth.albedo is not None and scene.truth.roughness is not None:
        content |= _textures(scene.truth.albedo, scene.truth.roughness)
    _write(folder / "solid.js", packing.script(f"{folder.parent.name}/truth/solid", content))
    sheets = _write_sheets(pictures, folder)
    relit = [[light, view.name] for light, views in easel.relit.items() for view in views]
    names = {"albedo": [view.name for view in easel.test], "view": [view.name for view in easel.views]}
    return {"folder": f"{folder.parent.name}", "sheets": sheets, "lights": easel.lights, "relit": relit, "views": names}


def _write_row(easel: Easel, true: Pictures, run: Recovered, folder: Path) -> dict[str, Any]:
    pictures = easel.recovered(run)
    errors, tiles = {}, {}
    for name, original in COMPARED.items():
        compared = zip(pictures.values[name], true.values[original], easel.masks[original], strict=True)
        maps = [packing.error_map(*three) for three in compared]
        errors[name] = packing.error_sheet(maps)
        tiles[name] = len(maps[0])
    place = f"{folder.parent.name}/{folder.name}"
    content = {"tile": tiles["albedo"], "sheets": errors, "levels": packing.LEVELS, "largest": packing.LARGEST}
    _write(folder / "errors.js", packing.script(f"{place}/errors", content))
    textures = _textures(read_exr(run.folder / "albedo.exr", 3), read_exr(run.folder / "roughness.exr", 1)[..., 0])
    _write(folder / "solid.js", packing.script(f"{place}/solid", textures))
    return {"folder": folder.name, "sheets": _write_sheets(pictures, folder), "scores": _scores(easel, run)}


def _textures(albedo: Any, roughness: Any) -> dict[str, str]:  # noqa: ANN401 (arrays)
    return {"albedo": solid.texture(albedo, encoded=True), "roughness": solid.texture(roughness, encoded=False)}


def _scores(easel: Easel, run: Recovered) -> dict[str, list[float | None]]:
    """The recorded score of every view that is shown: PSNR, of roughness the squared error."""
    recorded = run.metrics.get("per_image", dict)

    def of(values: dict[str, Any] | None, name: str, views: int, stride: int) -> list[float | None]:
        found = (values or {}).get(name, [])[::stride]
        return (
            [None if value is None else round(value, 1 if name == "psnr" else 4) for value in found]
            if len(found) == views
            else [None] * views
        )

    relit = recorded.get("relighting") or {}
    by_light = (of(relit.get(light), "psnr", len(views), RELIT_STRIDE) for light, views in easel.relit.items())
    return {
        "albedo": of(recorded.get("albedo"), "psnr", len(easel.test), 1),
        "aligned": of(recorded.get("aligned_albedo"), "psnr", len(easel.test), 1),
        "roughness": of(recorded.get("roughness"), "mse", len(easel.test), 1),
        "view": of(recorded.get("view_synthesis"), "psnr", len(easel.views), VIEW_STRIDE),
        "relit": [score for scores in by_light for score in scores],
    }


def _write_sheets(pictures: Pictures, folder: Path) -> dict[str, list[int]]:
    """Write every sheet; name -> its number of pictures and of columns."""
    described = {}
    for name, tiles in pictures.sheets.items():
        _write(folder / f"{name}.webp", packing.sheet(tiles))
        described[name] = [len(tiles), min(packing.COLUMNS, len(tiles))]
    return described


def _write(path: Path, content: bytes) -> None:
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
