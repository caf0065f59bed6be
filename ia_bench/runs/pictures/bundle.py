"""``pictures.zip`` of a run folder: the pictures of a run as a page shows them, with errors, textures and numbers of views."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.pictures import packing
from ia_bench.runs.pictures.drawing import VERSION, Pictures, SceneRenderer
from ia_bench.scenes.scene import Scene
from ia_bench.scores.predictions import Predictions

PICTURES = "pictures.zip"
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file within: the same run gives the same bytes
COMPARED = {"albedo": "albedo", "aligned": "albedo", "roughness": "roughness", "view": "view", "relit": "relit"}
"""What is compared with the truth -> under which name the truth has it."""


@dataclass(frozen=True)
class Bundle:
    """The pictures of one run.

    Attributes:
        sheets: Name -> a WebP with its pictures in rows.
        shapes: Name -> number of pictures and of columns on its sheet.
        errors: What the page's error maps are read from (JSON types).
        solid: Textures for the 3-D viewer, the mesh where it is not the scene's, and the recovered light where no true one is known
            (JSON types).
        views: How many there are of "test", of "view", and "relit" by light; "fitted": the names of those that are no held-out
            ones, if they are not.
    """

    sheets: dict[str, bytes]
    shapes: dict[str, list[int]]
    errors: dict[str, Any]
    solid: dict[str, str]
    views: dict[str, Any]

    def zipped(self) -> bytes:
        """The file."""
        buffer = io.BytesIO()
        about = {"version": VERSION, "shapes": self.shapes, "errors": self.errors, "solid": self.solid, "views": self.views}
        files = {f"{name}.webp": sheet for name, sheet in self.sheets.items()} | {"about.json": packing.compact(about).encode()}
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, content in files.items():
                archive.writestr(zipfile.ZipInfo(name, EPOCH), content)
        return buffer.getvalue()


def bundle(
    scene_renderer: SceneRenderer,
    true: Pictures,
    found: TexturedReconstruction,
    scale: torch.Tensor,
    scored: Predictions | None = None,
) -> Bundle:
    """Draw and pack what was recovered. ``true``: the same views of the truth; ``scored`` as in :meth:`SceneRenderer.drawn`."""
    pictures = scene_renderer.recovered(found, scale, scored)
    errors, tile = {}, 0
    for name, original in COMPARED.items():
        if name in pictures.values and original in true.values:
            compared = zip(pictures.values[name], true.values[original], scene_renderer.masks[original], strict=True)
            maps = [packing.error_map(*three) for three in compared]
            errors[name], tile = packing.error_sheet(maps), len(maps[0])
    textures = found.material.albedo.detach().cpu().numpy(), found.material.roughness.detach().cpu().numpy()[..., 0]
    relit = {name: len(views) for name, views in scene_renderer.relit.items()}
    views: dict[str, Any] = {"test": len(scene_renderer.test), "view": len(scene_renderer.views), "relit": relit}
    if scene_renderer.fitted:
        views["fitted"] = scene_renderer.fitted
    packed = Bundle(
        *sheets(pictures),
        errors={"tile": tile, "sheets": errors, "levels": packing.LEVELS, "largest": packing.LARGEST},
        solid=packing.textures(*textures),
        views=views,
    )
    if "light" not in true.sheets and found.environment is not None:
        packed.solid["light"] = packing.light(LatLongEnvironment(found.environment.texels.detach().cpu()))
    return packed


def sheets(pictures: Pictures) -> tuple[dict[str, bytes], dict[str, list[int]]]:
    """Every sheet, and its number of pictures and of columns, by name."""
    shapes = {name: [len(tiles), min(packing.COLUMNS, len(tiles))] for name, tiles in pictures.sheets.items()}
    return {name: packing.sheet(tiles) for name, tiles in pictures.sheets.items()}, shapes


def write_pictures(
    folder: RunFolder,
    scene: Scene,
    drawn: tuple[TexturedReconstruction, Predictions] | None,
    scale: list[float] | None,
    note: Callable[[str], None],
) -> None:
    """Write pictures.zip: what a report shows of the run, of the views that were drawn for its scores.

    ``scale`` aligns the albedo. A reconstruction without textures has nothing to show, and a scene that cannot be pictured is told
    to ``note``.
    """
    if drawn is None:
        return
    found, predictions = drawn
    try:
        scene_renderer = SceneRenderer(scene)
        packed = bundle(scene_renderer, scene_renderer.truth(turned=False), found, torch.tensor(scale or [1.0] * 3), predictions)
    except InputError as error:
        note(f"no pictures for the report: {error}")
    else:
        if scene.mesh_is_made:
            packed.solid["mesh"] = packing.solid(scene.expect_mesh())
        folder.write_bytes(PICTURES, packed.zipped())


def read_bundle(folder: Path) -> Bundle | None:
    """The pictures in a run folder; None where there are none, or of another version of the drawing.

    Raises InputError for a file that is damaged.
    """
    path = folder / PICTURES
    if not path.is_file():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            about = json.loads(archive.read("about.json"))
            if about["version"] != VERSION:
                return None
            found = {name: archive.read(f"{name}.webp") for name in about["shapes"]}
            return Bundle(found, about["shapes"], about["errors"], about["solid"], about["views"])
    except (zipfile.BadZipFile, KeyError, ValueError) as error:
        raise InputError(f"{path}: expected the pictures of a run, found a damaged file ({error})") from None
