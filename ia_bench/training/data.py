"""``python -m ia_bench.training.data``: renders the procedural training images of the priors into a folder of shards."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import INTERRUPTED, OK, complain
from ia_bench.common.machine import limit_threads
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.suggestions import unknown
from ia_bench.training.shards import SHARD_IMAGES, SHARDS, load_shard, read_info, shard_path

if TYPE_CHECKING:
    from ia_bench.training.shading import DirectLight

USAGE = """\
python -m ia_bench.training.data out=FOLDER [images=20000] [size=64] [seed=0] [workers=CORES] [shading=auto]

Renders procedural objects under procedural lights, with albedo, specular shading, normals and sky visibility beside
each image, into FOLDER/shard_00000.safetensors, ... (256 images each) and FOLDER/contact_sheet.png.
Image i of a seed is always the same image. Finished shards are kept, so that the command can be stopped and repeated,
or repeated with more images. Held-out images: another seed.

  out      folder; made where it is missing
  images   how many images the folder shall hold
  size     pixels a side
  seed     which of the endless sets
  workers  processes, one thread each
  shading  compiled (several seconds once, then faster; needs a C++ compiler), eager, or auto
"""

CONTACT_SHEET = "contact_sheet.png"
_SHEET_IMAGES = 48


@dataclass(frozen=True)
class Request:
    """The command line. ``size`` in pixels; ``shading`` as in ``render.shading``."""

    out: Path
    images: int = 20_000
    size: int = 64
    seed: int = 0
    workers: int = 1
    shading: str = "auto"


def parse(arguments: Sequence[str]) -> Request:
    """Read KEY=VALUE arguments. Raises InputError naming the key at fault, with the nearest known one."""
    values: dict[str, str] = {}
    for argument in arguments:
        key, separator, value = argument.partition("=")
        if key not in Request.__dataclass_fields__:
            raise InputError(unknown("setting of ia_bench.training.data", key, Request.__dataclass_fields__))
        if not separator or not value:
            raise InputError(f"{key}: expected {key}=VALUE, found '{argument}'")
        values[key] = value
    if "out" not in values:
        raise InputError("expected out=FOLDER, where the images go; --help says more")
    shading = values.get("shading", "auto")
    if shading not in ("auto", "compiled", "eager"):
        raise InputError(unknown("value of shading", shading, ["auto", "compiled", "eager"]))
    return Request(
        out=Path(values["out"]),
        images=_whole(values, "images", Request.images, 1),
        size=_whole(values, "size", Request.size, 8),
        seed=_whole(values, "seed", Request.seed, 0),
        workers=_whole(values, "workers", len(os.sched_getaffinity(0)), 1),
        shading=shading,
    )


def _whole(values: dict[str, str], key: str, default: int, least: int) -> int:
    text = values.get(key, str(default))
    if not text.isdecimal() or int(text) < least:
        raise InputError(f"{key}: expected a whole number, at least {least}, found '{text}'")
    return int(text)


def make_data(request: Request, progress: Progress) -> list[Path]:
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


def _refuse_more(request: Request, paths: list[Path], last: int) -> None:
    """Training takes all shards of a folder, so that one with more than was asked for would not be what was asked for."""
    beyond = sorted({*request.out.glob(SHARDS)} - {*paths})
    if beyond or (paths[-1].exists() and read_info(paths[-1]).count > last):
        raise InputError(f"{request.out}: expected at most images={request.images}, found more. Give another out= folder")


def _finished(path: Path, request: Request, first: int, count: int) -> bool:
    if not path.exists():
        return False
    info = read_info(path)
    if (info.seed, info.size, info.first) != (request.seed, request.size, first):
        raise InputError(
            f"{path}: expected images from {first} on of seed {request.seed}, size {request.size}; found images from "
            f"{info.first} on of seed {info.seed}, size {info.size}. Give another out= folder"
        )
    return info.count >= count


def _render(request: Request, progress: Progress, shards: list[tuple[Path, int, int]], advance: Callable[[int], None]) -> None:
    """Share the shards among worker processes."""
    from ia_bench.render.shading import choose_shading  # brings in torch

    compiled = choose_shading(request.shading, progress.note) == "compiled"
    spawn = multiprocessing.get_context("spawn")  # a forked copy of torch's thread pools may hang
    pool = ProcessPoolExecutor(min(request.workers, len(shards)), spawn, _begin_worker, (compiled,))
    try:
        jobs = {pool.submit(_work, path, request.seed, first, count, request.size): count for path, first, count in shards}
        for job in as_completed(jobs):
            job.result()
            advance(jobs[job])
    finally:
        pool.shutdown(cancel_futures=True)


_direct: DirectLight


def _begin_worker(compiled: bool) -> None:
    """One thread, one compiled estimator for all shards of this process, and an end when the parent ends."""
    global _direct
    limit_threads(1)
    from ia_bench.training.shading import DirectLight

    _direct = DirectLight(compiled=compiled)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(path: Path, seed: int, first: int, count: int, size: int) -> None:
    from ia_bench.training.generate import make_shard

    make_shard(path, seed, first, count, size, _direct)


def _write_sheet(shard: Path, path: Path) -> None:
    from ia_bench.training.sheet import contact_sheet

    tensors, info = load_shard(shard)
    step = max(1, info.count // _SHEET_IMAGES)
    contact_sheet(path, tensors, list(range(0, info.count, step))[:_SHEET_IMAGES])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(USAGE, end="")
        return OK
    try:
        request = parse(arguments)
        with Progress() as progress:
            make_data(request, progress)
        return OK
    except InputError as error:
        return complain(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
