"""``python -m ia_bench_training.fit_data``: fits procedural scenes, from which the refiner learns what fits get wrong."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.arguments import read_arguments
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress

USAGE = """\
python -m ia_bench_training.fit_data out=FOLDER [fits=2000] [size=64] [seed=0] [workers=CORES]

Draws procedural objects under procedural lights, photographs each from 2 to 40 sides (some noisy, some clipped to 8
bits), fits them without a prior, and writes what was recovered in up to 6 of the photographs, with what is true beside
it, into FOLDER/fit_SEED_00000.safetensors, ... A fit takes some seven seconds of one core.
Fit i of a seed is always the same. Finished ones are kept, so that the command can be stopped and repeated.

  out      folder; made where it is missing
  fits     how many of the seed it shall hold
  size     pixels a side of the photographs
  seed     which of the endless sets
  workers  processes, one thread each
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(lambda: USAGE, _make, arguments)


def _make(arguments: Sequence[str]) -> int:
    from ia_bench_training.fits.data import FitRequest, make_fits

    request = read_arguments(FitRequest, arguments)
    with Progress() as progress:
        make_fits(request, progress)
    return OK


if __name__ == "__main__":
    sys.exit(main())
