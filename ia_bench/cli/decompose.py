"""``ia-bench decompose IMAGE...``: albedo and specular shading behind single images, by a prior alone."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ia_bench.common.arguments import Parser, at_least
from ia_bench.common.errors import InputError, expect_distinct
from ia_bench.common.exit_codes import OK, exits, say
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.scenes.photograph import read_photograph


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    about = __doc__.partition("\n")[0].partition(": ")[2]
    parser = Parser(prog="ia-bench decompose", description=about)
    parser.add_argument("images", nargs="+", type=Path, metavar="IMAGE", help="PNG, JPEG, TIFF, ... (sRGB) or OpenEXR (linear)")
    parser.add_argument("--mask", type=Path, help="picture that is white on the object; else the image's alpha, else all of it")
    parser.add_argument("--out", type=Path, default=Path("decomposed"), help="folder for the results (default: decomposed)")
    parser.add_argument("--prior", default="regressor", help="a prior's name or module:Class (default: regressor)")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="an option of the prior, e.g. steps=20")
    parser.add_argument(
        "--samples", type=at_least(1), default=8, help="samples whose mean and spread are written, if it draws any (default: 8)"
    )
    parser.add_argument("--size", type=at_least(8), default=512, help="reduce larger images to this many pixels (default: 512)")
    parser.add_argument("--seed", type=at_least(0), default=0, help="seed of the samples (default: 0)")
    wanted = parser.parse_args(arguments)
    if wanted.mask is not None and len(wanted.images) > 1:
        raise InputError(f"--mask: expected one image with it, found {len(wanted.images)}")
    expect_distinct("expected images of different names, or one by one", [path.stem for path in wanted.images])
    from ia_bench.runs.decomposition import decompose_with, make_prior, reduced, write_decomposition  # brings in torch

    def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
        """A picture, reduced at once: there may be many, and large ones."""
        radiance, coverage = read_photograph(path, wanted.mask, notice=lambda text: say(text, sys.stdout))
        if bool((coverage == 1).all()):
            say(f"{path}: no mask: the whole picture is taken as the object; --mask or its alpha says what is", sys.stdout)
        return reduced(radiance, coverage, wanted.size)

    pictures = [read(path) for path in wanted.images]  # all mistakes come before any work
    maker = make_prior(wanted.prior, {}, [f"prior.options.{text}" for text in wanted.option])
    make_writable(wanted.out, "--out")
    for path, picture in zip(wanted.images, pictures, strict=True):
        with Progress() as progress:
            parts = decompose_with(maker, *picture, samples=wanted.samples, seed=wanted.seed, begin=progress.task)
        counts = {"sample": parts.samples, "network evaluation": parts.network_calls}
        told = ", ".join(f"{count} {what}{'s' * (count != 1)}" for what, count in counts.items())
        say(f"{path}: {told}", sys.stdout)
        for written in write_decomposition(parts, wanted.out, path.stem):
            say(f"  {written}", sys.stdout)
    return OK
