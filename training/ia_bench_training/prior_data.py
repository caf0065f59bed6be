"""``python -m ia_bench_training.prior_data``: renders the procedural training images of the priors into a folder of shards."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.arguments import read_arguments
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress
from ia_bench_training.data import ImageRequest, make_data

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(lambda: USAGE, _make, arguments)


def _make(arguments: Sequence[str]) -> int:
    request = read_arguments(ImageRequest, arguments)
    with Progress() as progress:
        make_data(request, progress)
    return OK


if __name__ == "__main__":
    sys.exit(main())
