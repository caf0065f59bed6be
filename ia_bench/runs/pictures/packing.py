"""Pack pictures into what a page from disk can use: sheets as WebP, errors as numbers within a script, the object for a viewer.

``pictures.zip`` of a run folder holds them, with textures and numbers of views.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from PIL import Image
from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.files import compact_json
from ia_bench.common.progress import Progress
from ia_bench.common.settings import parsed
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.render.asset_files import glb
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.packs import BROKEN, EPOCH
from ia_bench.runs.pictures.drawing import TURNS, VERSION, Pictures, SceneRenderer
from ia_bench.runs.pictures.preview import PREVIEW, preview
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import rgbe
from ia_bench.scenes.scene import Mesh, Scene
from ia_bench.scores.comparison import Predictions

TILE = 128  # pixels along a side of a picture on a sheet, at most
ERROR_TILE = 64  # the same of an error, which is a mean over what a pixel of it covers
COLUMNS = 5
LEVELS = 48  # of an error, evenly spaced in its square root
LARGEST = 0.5  # error that the last level stands for
OUTSIDE = 255  # a pixel of an error map that is not scored
PICTURE_QUALITY = 64
EFFORT = 75  # of a lossless picture: 100 takes twelve times as long for 4 % fewer bytes
SMALL = 64  # pixels along a side of a picture that would lose its colours, which a lossy WebP halves in size
TEXTURE, TEXTURE_QUALITY = 256, 50  # texels along a side
STEPS = {"vertices": 2**13, "normals": 2**7, "uv": 2**12}  # a unit is divided into that many: finer than a pixel of the viewer
LIGHT_ROWS = 32
PICTURES = "pictures.zip"
ALL_BYTES = 256 << 20  # of them, unpacked: a thousand times as many as usual
COMPARED = {"albedo": "albedo", "aligned": "albedo", "roughness": "roughness", "view": "view", "relit": "relit"}
"""What is compared with the truth -> under which name the truth has it."""


# ---- pictures and errors ----


def sheet(pictures: Sequence[np.ndarray]) -> bytes:
    """Pictures of one shape (H, W, 3) in [0, 1], in rows of COLUMNS, as one WebP; a picture is at most TILE pixels high."""
    tiles = [Image.fromarray(np.round(255 * picture).astype(np.uint8)) for picture in pictures]
    for tile in tiles:
        tile.thumbnail((tile.width, TILE), Image.Resampling.LANCZOS, reducing_gap=None)
    width, height = tiles[0].size
    columns = min(COLUMNS, len(tiles))
    whole = Image.new("RGB", (columns * width, -(-len(tiles) // columns) * height))
    for place, tile in enumerate(tiles):
        whole.paste(tile, (place % columns * width, place // columns * height))
    return _webp(whole, quality=PICTURE_QUALITY, lossless=height <= SMALL)


def error_map(predicted: np.ndarray, true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root of the mean squared difference over channels and over the scored pixels that a coarser pixel covers.

    ``predicted`` and ``true`` (S, S, C) in [0, 1], ``mask`` (S, S) True where scored. Returns (s, s) levels up to LEVELS - 1, or
    OUTSIDE; s is S over the least whole number that makes it no more than ERROR_TILE.
    """
    squares = ((predicted - true) ** 2).mean(-1) * mask
    step = -(-len(mask) // ERROR_TILE)
    over = -len(mask) % step
    blocks = [np.pad(part, ((0, over), (0, over))).reshape((len(mask) + over) // step, step, -1, step) for part in (squares, mask)]
    total, count = (part.sum((1, 3)) for part in blocks)
    error = np.sqrt(total / np.maximum(count, 1))
    levels = np.round((LEVELS - 1) * np.sqrt(error.clip(0, LARGEST) / LARGEST))
    return np.where(count > 0, levels, OUTSIDE).astype(np.uint8)


def _webp(image: Image.Image, *, quality: int = EFFORT, lossless: bool = False) -> bytes:
    """A WebP; the ``quality`` of a lossless one is the effort that the encoder makes."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=quality, lossless=lossless, method=6, exact=False)
    return buffer.getvalue()


def _data_url(image: Image.Image, **settings: Any) -> str:  # noqa: ANN401 (of _webp)
    """A picture as an address that needs no file."""
    return f"data:image/webp;base64,{base64.b64encode(_webp(image, **settings)).decode()}"


# ---- the object for the 3-D viewer: its mesh once a scene, textures once a run, lights as Radiance HDR ----


def solid(mesh: Mesh) -> str:
    """The mesh as a glTF binary without textures, compressed by gzip, in base 64; rounded, since rounded numbers compress."""
    parts = {name: (np.round(getattr(mesh, name) * steps) / steps).astype(np.float32) for name, steps in STEPS.items()}
    parts["vertices"] = parts["vertices"] + np.float32(0)  # no negative zeros
    blank = np.ones((1, 1), np.float32)
    return base64.b64encode(gzip.compress(glb(replace(mesh, **parts), np.ones((1, 1, 3), np.float32), blank), mtime=0)).decode()


def textures(albedo: np.ndarray, roughness: np.ndarray) -> dict[str, str]:
    """Linear textures (T, T, 3) and (T, T) as addresses of pictures: albedo in sRGB, roughness as it is."""
    grey = np.broadcast_to(roughness.clip(0, 1)[..., None], (*roughness.shape, 3))
    return {"albedo": _texture(linear_to_srgb(albedo.clip(0, 1))), "roughness": _texture(grey)}


def light(environment: LatLongEnvironment) -> str:
    """A light as a Radiance HDR picture in base 64. Viewers of glTF lay maps out as we do; their y is our z."""
    return base64.b64encode(rgbe(environment.latlong(LIGHT_ROWS).numpy())).decode()


def _texture(shown: np.ndarray) -> str:
    picture = Image.fromarray(np.round(255 * shown).astype(np.uint8))
    if picture.width > TEXTURE:
        picture = picture.resize((TEXTURE, TEXTURE), Image.Resampling.BOX)
    return _data_url(picture, quality=TEXTURE_QUALITY)


def script(name: str, content: dict[str, Any]) -> bytes:
    """A script that hands ``content`` to the page under a name."""
    return f"bench.receive({compact_json(name)},{compact_json(content)});\n".encode()


# ---- pictures.zip ----


SomeViews = Annotated[int, Field(ge=0, le=10_000)]  # of a bundle that may be somebody else's


@dataclass(frozen=True)
class ShownViews:
    """How many views are shown of each kind, ``relit`` by light; ``fitted``: their names, if none of them was held out."""

    test: SomeViews
    view: SomeViews
    relit: dict[str, SomeViews]
    fitted: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Bundle:
    """The pictures of one run.

    Attributes:
        sheets: Name -> a WebP with its pictures in rows.
        shapes: Name -> number of pictures and of columns on its sheet.
        errors: What the page's error maps are read from (JSON types).
        solid: Textures for the 3-D viewer, the mesh where it is not the scene's, and the recovered light where no true one is known
            (JSON types).
        views: Which views they show.
    """

    sheets: dict[str, bytes]
    shapes: dict[str, list[int]]
    errors: dict[str, Any]
    solid: dict[str, str]
    views: ShownViews

    def zipped(self) -> bytes:
        """The file."""
        buffer = io.BytesIO()
        views = {name: part for name, part in vars(self.views).items() if name != "fitted" or part}
        about = {"version": VERSION, "shapes": self.shapes, "errors": self.errors, "solid": self.solid, "views": views}
        files = {f"{name}.webp": sheet for name, sheet in self.sheets.items()} | {"about.json": compact_json(about).encode()}
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, content in files.items():
                packed = zipfile.ZIP_DEFLATED if name.endswith(".json") else zipfile.ZIP_STORED  # pictures are packed already
                archive.writestr(zipfile.ZipInfo(name, EPOCH), content, compress_type=packed)
        return buffer.getvalue()


def bundle(scene_renderer: SceneRenderer, true: Pictures, found: TexturedReconstruction, pictures: Pictures) -> Bundle:
    """Pack the ``pictures`` of what was recovered (:meth:`SceneRenderer.recovered`). ``true``: the same views of the truth."""
    errors, tile = {}, 0
    for name, original in COMPARED.items():
        if name in pictures.values and original in true.values:
            compared = zip(pictures.values[name], true.values[original], scene_renderer.masks[original], strict=True)
            maps = [error_map(*three) for three in compared]
            errors[name], tile = _data_url(Image.fromarray(np.concatenate(maps)), lossless=True), len(maps[0])
    solid = textures(*(part.detach().cpu().numpy() for part in (found.material.albedo, found.material.roughness[..., 0])))
    if "light" not in true.sheets and found.environment is not None:
        solid["light"] = light(LatLongEnvironment(found.environment.texels.detach().cpu()))
    relit = {name: len(views) for name, views in scene_renderer.relit.items()}
    views = ShownViews(len(scene_renderer.test), len(scene_renderer.views), relit, scene_renderer.fitted)
    about = {"tile": tile, "sheets": errors, "levels": LEVELS, "largest": LARGEST}
    return Bundle(*sheets(pictures), errors=about, solid=solid, views=views)


def sheets(pictures: Pictures) -> tuple[dict[str, bytes], dict[str, list[int]]]:
    """Every sheet, and its number of pictures and of columns, by name."""
    shapes = {name: [len(tiles), min(COLUMNS, len(tiles))] for name, tiles in pictures.sheets.items()}
    return {name: sheet(tiles) for name, tiles in pictures.sheets.items()}, shapes


def write_bundle(
    folder: RunFolder,
    scene: Scene,
    drawn: tuple[TexturedReconstruction, Predictions] | None,
    scale: list[float] | None,
    title: str,
    progress: Progress,
) -> None:
    """Write what a report shows of the run, pictures.zip, and preview.png below a ``title``; ``scale`` aligns the albedo.

    Views that were drawn for the scores are not drawn again. Nothing is written of a reconstruction without textures; a scene that
    cannot be pictured is noted.
    """
    if drawn is None:
        return
    found, predictions = drawn
    task = progress.task("pictures", TURNS + 1)
    try:
        scene_renderer = SceneRenderer(scene)
        true = scene_renderer.truth(turned=False)
        pictures = scene_renderer.recovered(found, torch.tensor(scale or [1.0] * 3), predictions, task.advance)
        packed = bundle(scene_renderer, true, found, pictures)
    except InputError as error:
        progress.note(f"no pictures for the report: {error}")
    else:
        with folder.path_for(PREVIEW) as path:
            places = scene_renderer.of_one_view()
            title = ": ".join(filter(None, (title, scene_renderer.told_apart(places))))
            preview(title, true, pictures, places).save(path, "PNG")
        if scene.mesh_is_made or not found.mesh.same_as(scene.mesh, uv=True):
            packed.solid["mesh"] = solid(found.mesh)
        folder.write_bytes(PICTURES, packed.zipped())
        task.advance(task.total - task.done)


def read_bundle(folder: Path) -> Bundle | None:
    """The pictures in a run folder; None where there are none, or of another version of the drawing.

    Raises InputError for a file that is damaged. It may be somebody else's, of a pack: sheets are written into the page's folder
    under their names, which lead to no other place.
    """
    path = folder / PICTURES
    if not path.is_file():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if (size := sum(one.file_size for one in archive.infolist())) > ALL_BYTES:
                raise ValueError(f"{size >> 20} MB of pictures, more than {ALL_BYTES >> 20}")
            about = json.loads(archive.read("about.json"))
            if about.pop("version") != VERSION:
                return None
            found = parsed(Bundle, {"sheets": {}, **about})
            if odd := [name for name in found.shapes if not name.isidentifier()]:
                raise ValueError(f"shapes: expected words as names, found {odd[0]}")
            return replace(found, sheets={name: archive.read(f"{name}.webp") for name in found.shapes})
    except (*BROKEN, AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: expected the pictures of a run, found a damaged file ({error})") from None
