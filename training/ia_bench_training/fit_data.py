"""``python -m ia_bench_training.fit_data``: fits procedural scenes, from which the refiner learns what fits get wrong."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.machine import cores
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, Number
from ia_bench_training.commands import command_of
from ia_bench_training.fit_files import fit_path, load_fit, write_fit
from ia_bench_training.pool import share_out

USAGE = """\
python -m ia_bench_training.fit_data out=FOLDER [fits=2000] [size=64] [seed=0] [workers=CORES]

Draws procedural objects under procedural lights, photographs each from 2 to 40 sides (some noisy, some clipped to 8
bits), fits them without a prior, and writes what was recovered in up to 6 of the photographs, with what is true beside
it, into FOLDER/fit_SEED_00000.safetensors, ... A fit takes some seven seconds of one core.
Fit i of a seed is always the same. Finished ones are kept, so that the command can be stopped and repeated.

  out      folder; made where it is missing. Fits of several seeds may lie in it
  fits     how many of the seed it shall hold
  size     pixels a side of the photographs
  seed     which of the endless sets
  workers  processes, one thread each
"""


@dataclass(frozen=True)
class FitRequest:
    """Which fits, and how they are made; USAGE says what each setting is."""

    out: Path
    fits: Number = 2000
    size: Annotated[int, Field(ge=16, multiple_of=8)] = 64
    seed: Count = 0
    workers: Number = field(default_factory=cores)


def make_fits(request: FitRequest, progress: Progress) -> list[Path]:
    """Make what the folder lacks and return the paths of the fits asked for.

    Raises InputError if the folder cannot be used, or holds a file under the name of one of them that is no fit, or one in
    photographs of another size.
    """
    make_writable(request.out, "out")
    paths = [fit_path(request.out, request.seed, index) for index in range(request.fits)]
    for path in paths:
        if path.exists():
            found = load_fit(path)[0]["image"].shape[1]
            if found != request.size:
                raise InputError(f"{path}: expected a fit in photographs of size={request.size} pixels a side, found {found}")
    jobs = [(path, request.seed, index, request.size) for index, path in enumerate(paths) if not path.exists()]
    task = progress.task(f"fits of seed {request.seed}", request.fits, done=request.fits - len(jobs))
    if jobs:
        for _ in share_out(_work, jobs, workers=request.workers):
            task.advance(1)
    progress.note(f"{request.out}: {request.fits} fits of seed {request.seed}")
    return paths


def _work(path: Path, seed: int, index: int, size: int) -> None:
    from ia_bench_training.fits.make import make_fit

    write_fit(path, *make_fit(seed, index, size))


main = command_of(USAGE, FitRequest, make_fits)


if __name__ == "__main__":
    sys.exit(main())
