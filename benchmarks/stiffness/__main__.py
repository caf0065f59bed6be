"""Measure how stiff scenes are: the spectrum of the fit's Gauss-Newton operator at their ground truth.

    python -m benchmarks.stiffness hat ship console figurine tiny --out FOLDER

J is that of the tone-mapped radiance of random training pixels with respect to albedo, roughness (both per unit) and log light,
at fixed samples. The spectrum is dense, of changes that are constant on blocks of texels; the fit's own resolution gets its
stiffest directions by Lanczos. Being at the truth, this is an analysis and no part of a fit. Samples beyond the fit's matter:
noise in J makes parameters look more distinct than they are, so that the flat end is too high by what they leave.

Writes stiffness.json (every number), spectra.png, and SCENE.png: what the images confuse.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import torch

from benchmarks.stiffness.measure import Grids, Measurement, measure
from benchmarks.stiffness.pictures import draw_confusions, draw_spectra
from benchmarks.stiffness.stage import TruthOfAFit
from ia_bench.common.arguments import at_least
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, complain
from ia_bench.runs.config import SceneConfig, resolve_scene_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print one row a scene, write the files."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stiffness", description=about, epilog=more,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("scenes", nargs="+", help="names of shipped scenes, or scene folders")
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    parser.add_argument("--pixels", type=at_least(1), default=3072, help="random pixels of the training views")
    parser.add_argument("--samples", type=at_least(1), default=512, help="a pixel")
    parser.add_argument("--bounces", type=at_least(0), help="of indirect light (default: as many as a run's plan takes)")
    parser.add_argument("--texture", type=at_least(1), default=16, help="blocks along a side of the textures")
    parser.add_argument("--light", type=at_least(1), default=16, help="rows of blocks of the light")
    parser.add_argument("--directions", type=at_least(1), default=3, help="confused directions in the pictures")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    measured: dict[str, Measurement] = {}
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        for name in options.scenes:
            folder = resolve_scene_folder(SceneConfig(name=name, path=name if Path(name).is_dir() else None))
            assert folder is not None
            bounces: int | Literal["auto"] = "auto" if options.bounces is None else options.bounces
            stage = TruthOfAFit.at_truth(folder, samples=options.samples, bounces=bounces)
            found = measure(stage, Grids(options.pixels, options.texture, options.light), options.directions)
            if not measured:
                print("| " + " | ".join(row(found.numbers)) + " |\n|" + " :--- |" * len(row(found.numbers)))
            measured[folder.name] = found
            print("| " + " | ".join(row(found.numbers).values()) + " |", flush=True)
            draw_confusions(options.out / f"{folder.name}.png", stage, found)
            numbers = {key: value.numbers for key, value in measured.items()}
            with whole_file(options.out / "stiffness.json") as partial:
                partial.write_text(json.dumps(numbers, indent=1) + "\n")
            draw_spectra(options.out / "spectra.png", {key: value.values for key, value in measured.items()})
    except InputError as error:
        return complain(str(error))
    return OK


def row(numbers: dict[str, Any]) -> dict[str, str]:
    """The columns of the printed table."""
    cast, kept = numbers["casts"]["all"], numbers["kept_information"]
    flat, stiff = numbers["shares_flattest_tenth"], numbers["shares_stiffest_percent"]
    return {
        "scene": numbers["scene"],
        "unknowns": str(sum(numbers["parameters"].values())),
        "condition": f"{numbers['condition']:.1e}",
        "with a rate each": f"{numbers['condition_jacobi']:.0f}",
        "stiffest 1 %: albedo / roughness / light": " / ".join(f"{share:.2f}" for share in stiff.values()),
        "flattest 10 %": " / ".join(f"{share:.2f}" for share in flat.values()),
        "kept when the others are unknown": " / ".join(f"{share:.2f}" for share in kept.values()),
        "confused (mu < 0.1)": f"{numbers['confused_below']['0.1']} of {numbers['compared']}",
        "cast of 10 %: mu": f"{cast['mu']:.3f}",
        "image change / of the light alone": f"{cast['image_change']:.4f} / {cast['light_alone']:.4f}",
    }


if __name__ == "__main__":
    sys.exit(main())
