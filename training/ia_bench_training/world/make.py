"""``python -m ia_bench_training.world.make``: traces the views of a world and decodes its textures and lights, into one folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.machine import settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, Number
from ia_bench_training.commands import command_of
from ia_bench_training.palettes import palette
from ia_bench_training.pool import share_out
from ia_bench_training.real_sources import open_files
from ia_bench_training.world import banks, views
from ia_bench_training.world.layout import ATLAS, ATLAS_LEVELS, BANKS, KINDS, LEVELS, TILE, VIEWS, WORLD, filtered

USAGE = """\
python -m ia_bench_training.world.make out=FOLDER [real=results/real] [KEY=VALUE ...]

Makes what training images are made of while a network trains: views of procedural objects and of every real mesh that is open
to training, their textures, photographed and procedural lights. What results are measured on is refused (datasets/real).
Finished files are kept, so that the command can be stopped and repeated, or repeated with more objects.

  out      folder; made where it is missing
  real     folder of `make real-data`; real=none: a procedural world
  objects  procedural ones (600)
  views    of each object (4); real meshes have twice as many
  tiles    procedural textures (600)
  lights   procedural ones (150)
  size     pixels a side (64)
  seed     of everything that is drawn (0)
  workers  processes, one thread each (1)
"""
PART = 25  # objects in a file of views
OBJECTS = "objects"  # what the metadata of such a file call their number
PALETTES = 1024
_TILE, _LIGHT, _PALETTE, _OBJECT, _MESH = range(5)  # purposes of random streams


@dataclass(frozen=True)
class WorldRequest:
    """What a world holds; USAGE says what each setting is."""

    out: Path
    real: Path = Path("results/real")
    objects: Number = 600
    views: Number = 4
    tiles: Number = 600
    lights: Number = 150
    size: Annotated[int, Field(ge=8, multiple_of=8)] = 64
    seed: Count = 0
    workers: Number = 1


def make_world(request: WorldRequest, progress: Progress) -> None:
    """Make what the folder lacks. Raises InputError for one that cannot be used, or that holds another world."""
    make_writable(request.out, "out")
    meshes = _meshes(request.real)
    described = {"size": request.size, "seed": request.seed, "views": request.views, "meshes": [path.stem for path in meshes]}
    place = request.out / WORLD
    if place.exists() and read_json(place) != described:
        raise InputError(f"{place}: expected the same size, seed, views and real meshes, found others; give another out= folder")
    with whole_file(place) as partial:
        partial.write_text(json.dumps(described))
    _refuse_others(request)
    if not (request.out / BANKS).is_file():
        _save(request.out / BANKS, _banks(request, meshes, progress))
    jobs: list[tuple[WorldRequest, int, int, list[Path]]] = []
    jobs += [(request, first, min(PART, request.objects - first), []) for first in range(0, request.objects, PART)]
    jobs += [(request, first, 0, meshes[first : first + PART]) for first in range(0, len(meshes), PART)]
    jobs.sort(key=lambda job: job[1])  # so that what there is of a world is of both kinds
    task = progress.task("files of views", len(jobs))
    for _ in share_out(_trace, jobs, workers=request.workers):
        task.advance(1)


def _refuse_others(request: WorldRequest) -> None:
    """Banks are made once, and training takes all views that there are."""
    beyond = sorted(request.out.glob(f"views_{KINDS[0]}_*"))[-(-request.objects // PART) :]
    if beyond:
        raise InputError(f"{beyond[0]}: expected the views of objects={request.objects}, found more; give another out= folder")
    if (request.out / BANKS).is_file():
        with safe_open(request.out / BANKS, "pt") as file:
            counts = [file.get_slice(name).get_shape()[0] for name in ("tiles.mean", "lights")]
            tiles, lights = (count - real for count, real in zip(counts, file.get_tensor("real").tolist(), strict=True))
        if (tiles, lights) != (request.tiles, request.lights):
            expected = f"expected tiles={request.tiles} and lights={request.lights}"
            raise InputError(f"{request.out / BANKS}: {expected}, found {tiles} and {lights}; give another out= folder")


def _meshes(real: Path) -> list[Path]:
    if str(real) == "none":
        return []
    found = open_files(sorted((real / "objects").glob("*/*.glb")))
    if not found:
        expected = "expected the folder of `make real-data` (or real=none)"
        raise InputError(f"{real}: {expected}, found no objects/*/*.glb that is open to training")
    return found


def _banks(request: WorldRequest, meshes: Sequence[Path], progress: Progress) -> dict[str, Tensor]:
    """Textures, lights and palettes; what is real comes first, and its numbers are in ``real``."""
    tiles, chances, lights = np.zeros((0, TILE, TILE, 5), np.uint8), np.zeros(0), list[Tensor]()
    if meshes:
        tiles, chances = banks.real_tiles(request.real)
        paths = open_files(sorted((request.real / "lights").rglob("*.hdr")))
        lights = [light for k, path in enumerate(paths) for light in banks.photographed(path, _stream(request, _LIGHT, k, 1))]
    real_tiles, real_lights = len(tiles), len(lights)
    drawn = np.stack([banks.procedural_tile(_stream(request, _TILE, k)) for k in range(request.tiles)])
    lights += [banks.procedural_light(_stream(request, _LIGHT, k)) for k in range(request.lights)]
    atlases = np.zeros((max(len(meshes), 1), ATLAS, ATLAS, 5), np.uint8)
    drawn_meshes = 0
    for number, path in enumerate(meshes):
        asset = views.load_mesh(path)
        if asset is not None:
            drawn_meshes += 1
            atlases[number] = banks.atlas(asset.albedo, asset.roughness, asset.metallic)
    if meshes:
        real = f"{real_tiles} real textures, {real_lights // banks.VARIANTS} photographed lights, {drawn_meshes} real meshes"
        progress.note(f"{real}; {len(meshes) - drawn_meshes} are left out, for their textures repeat")
    stored = {"tiles": banks.packed(np.concatenate([tiles, drawn]), LEVELS), "atlases": banks.packed(atlases, ATLAS_LEVELS)}
    return {
        **{f"{name}.{part}": values for name, parts in stored.items() for part, values in parts.items()},
        "chances": torch.from_numpy(chances).float(),
        "lights": filtered(torch.stack(lights)),
        "palettes": torch.from_numpy(np.stack([palette(_stream(request, _PALETTE, k), 6) for k in range(PALETTES)])).float(),
        "real": torch.tensor([real_tiles, real_lights]),
    }


def _trace(request: WorldRequest, first: int, count: int, meshes: Sequence[Path]) -> None:
    """Trace ``count`` procedural objects from number ``first`` on, or these real ``meshes``, into a file of their own."""
    path = request.out / VIEWS.format(KINDS[bool(meshes)], first // PART)
    if path.is_file() and (meshes or _objects(path) == count):  # it is of others where more or fewer were asked for
        return
    found, atlases = list[dict[str, Tensor]](), list[int]()
    for number in range(first, first + (count or len(meshes))):
        rng = _stream(request, _MESH if meshes else _OBJECT, number)
        if meshes:  # two views of each pose
            asset = views.load_mesh(meshes[number - first])
            shapes = [] if asset is None else [views.real(asset, number, rng) for _ in range(request.views)]
        else:
            shapes = [views.procedural(rng)]
        for shape in shapes:
            seen = views.trace(shape, rng, 2 if meshes else request.views, request.size)
            found, atlases = found + seen, atlases + [shape.atlas] * len(seen)
    if found:
        _save(path, views.gathered(found, atlases), {OBJECTS: str(count)})


def _objects(path: Path) -> int:
    """How many procedural objects a file of views was made of; files of before this was written hold PART."""
    with safe_open(path, "pt") as file:
        return int((file.metadata() or {}).get(OBJECTS, PART))


def _stream(request: WorldRequest, *path: int) -> np.random.Generator:
    return np.random.default_rng([request.seed, *path])


def _save(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str] | None = None) -> None:
    with whole_file(path) as partial:
        save_file({name: values.contiguous() for name, values in tensors.items()}, partial, metadata)


main = command_of(USAGE, WorldRequest, make_world)


if __name__ == "__main__":
    settle_libraries(1)
    sys.exit(main())
