"""``python -m ia_bench_training.convert_weights``: the original release's checkpoints as weights that this package reads."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.arguments import read_arguments
from ia_bench.common.exit_codes import OK, command

USAGE = """\
python -m ia_bench_training.convert_weights [albedo=CKPT] [specular=CKPT] out=FOLDER
                                       [albedo_sha256=HEX] [specular_sha256=HEX] [resolution=256]

Reads last.ckpt of the albedo and / or the specular model of IntrinsicAnything and writes, per component,
FOLDER/<component>/{unet,vae,image_encoder,scheduler}: safetensors in half precision, the moving average of the weights
alone. Nothing in the checkpoint is executed. Then: prior=intrinsicanything prior.options.weights=FOLDER

*_sha256     refuse a checkpoint with any other hash; without it the hash is printed and recorded as not verified
resolution   side in pixels of the images that the model was trained on
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 done, 2 a mistake in what was asked."""
    return command(lambda: USAGE, _convert, arguments)


def _convert(arguments: Sequence[str]) -> int:
    from ia_bench.priors.original.convert import Request, convert  # brings in torch

    convert(read_arguments(Request, arguments))
    return OK


if __name__ == "__main__":
    sys.exit(main())
