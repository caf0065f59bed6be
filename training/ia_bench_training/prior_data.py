"""``python -m ia_bench_training.prior_data``: renders the procedural training images of the priors into a folder of shards."""

from __future__ import annotations

import fcntl
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.machine import cores
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, Number
from ia_bench_training.commands import command_of
from ia_bench_training.pool import share_out
from ia_bench_training.shards import SHARD_IMAGES, SHARDS, load_shard, read_info, shard_path
from ia_bench_training.speed import compiles

if TYPE_CHECKING:
    from ia_bench_training.shading import DirectLight

CONTACT_SHEET = "contact_sheet.png"
_SHEET_IMAGES = 48
USAGE = """\
python -m ia_bench_training.prior_data out=FOLDER [images=20000] [size=64] [seed=0] [workers=CORES] [compile=auto]

Renders procedural objects under procedural lights, with albedo, specular shading, normals and sky visibility beside
each image, into FOLDER/shard_00000.safetensors, ... (256 images each) and FOLDER/contact_sheet.png.
Image i of a seed is always the same image. Finished shards are kept, so that the command can be stopped and repeated,
or repeated with more images. Held-out images: another seed.

  out      folder; made where it is missing
  images   how many images the folder shall hold
  size     pixels a side
  seed     which of the endless sets
  workers  processes, one thread each
  compile  true (several seconds once, then faster; needs a C++ compiler), false, or auto
"""


@dataclass(frozen=True)
class ImageRequest:
    """Which images, and how they are made; USAGE says what each setting is."""

    out: Path
    images: Number = 20_000
    size: Annotated[int, Field(ge=8)] = 64
    seed: Count = 0
    workers: Number = field(default_factory=cores)
    compile: bool | Literal["auto"] = "auto"


def make_data(request: ImageRequest, progress: Progress) -> list[Path]:
    """Render what the folder lacks and return the paths of its shards.

    Raises InputError if the folder cannot be used, holds other images (seed, size or version), or another process is filling
    it.
    """
    make_writable(request.out, "out")
    with (request.out / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{request.out}: another process is filling this folder") from None
        for leftover in request.out.glob(".tmp-*"):  # of a process that was killed while writing
            leftover.unlink()
        starts = range(0, request.images, SHARD_IMAGES)
        counts = [min(SHARD_IMAGES, request.images - first) for first in starts]
        paths = [shard_path(request.out, number) for number in range(len(counts))]
        _refuse_more(request, paths, counts[-1])
        missing = [k for k, path in enumerate(paths) if not _finished(path, request, starts[k], counts[k])]
        ready = request.images - sum(counts[k] for k in missing)
        task = progress.task(f"images of seed {request.seed}", request.images, done=ready)
        if missing:
            _render(request, progress, [(paths[k], starts[k], counts[k]) for k in missing], task.advance)
        redrawn = sum(read_info(path).redrawn for path in paths)
        progress.note(f"{request.out}: {len(paths)} shards, {request.images} images ({redrawn} draws rejected)")
        _write_sheet(paths[0], request.out / CONTACT_SHEET)
    return paths


def _refuse_more(request: ImageRequest, paths: list[Path], last: int) -> None:
    """Training takes all shards of a folder, so that one with more than was asked for would not be what was asked for."""
    beyond = sorted({*request.out.glob(SHARDS)} - {*paths})
    if beyond or (paths[-1].exists() and read_info(paths[-1]).count > last):
        raise InputError(f"{request.out}: expected at most images={request.images}, found more. Give another out= folder")


def _finished(path: Path, request: ImageRequest, first: int, count: int) -> bool:
    if not path.exists():
        return False
    info = read_info(path)
    if (info.seed, info.size, info.first) != (request.seed, request.size, first):
        raise InputError(
            f"{path}: expected images from {first} on of seed {request.seed}, size {request.size}; found images from "
            f"{info.first} on of seed {info.seed}, size {info.size}. Give another out= folder"
        )
    return info.count >= count


def _render(request: ImageRequest, progress: Progress, shards: list[tuple[Path, int, int]], advance: Callable[[int], None]) -> None:
    """Share the shards among worker processes."""
    compiled = compiles(request.compile, "shading", progress.note)
    jobs = [(path, request.seed, first, count, request.size, compiled) for path, first, count in shards]
    for finished in share_out(_work, jobs, workers=request.workers):
        advance(shards[finished][2])


def _work(path: Path, seed: int, first: int, count: int, size: int, compiled: bool) -> None:
    from ia_bench_training.generate import make_shard

    make_shard(path, seed, first, count, size, _direct_light(compiled))


@cache
def _direct_light(compiled: bool) -> DirectLight:
    """One estimator for all shards of a process."""
    from ia_bench_training.shading import DirectLight

    return DirectLight(compiled=compiled)


def _write_sheet(shard: Path, path: Path) -> None:
    from ia_bench_training.sheet import contact_sheet

    tensors, info = load_shard(shard)
    step = max(1, info.count // _SHEET_IMAGES)
    contact_sheet(path, tensors, list(range(0, info.count, step))[:_SHEET_IMAGES])


main = command_of(USAGE, ImageRequest, make_data)


if __name__ == "__main__":
    sys.exit(main())
