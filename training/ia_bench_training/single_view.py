"""What priors know from one image: their samples against the truth, beside the image taken as albedo, one grey and a constant.

    python -m ia_bench_training.single_view hat ship console figurine --prior diffusion regressor retinex --seeds 0 1 2

One Markdown row per prior and scene (its test views) or folder of held-out training images. PSNR in dB of linear values inside
the mask, per image, then averaged over those that show something. Albedo is scaled by one factor per image that makes its mean
the truth's ("..., channels": one per channel, which forgives a colour cast), and so is the grey. Specular shading is not scaled,
but shown at the exposure at which the image nearly fills a display, and clipped there; the constant is the best colour for each
image, so it has seen the truth. ± is half the range that holds the mean over seeds with 95 % confidence (Student's t). – is what
a prior does not provide.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product

from ia_bench.common.arguments import at_least
from ia_bench.common.exit_codes import OK, say, status_of
from ia_bench.report.statistics import over_scenes
from ia_bench.runs.decomposition import make_prior
from ia_bench_training.single_view_scores import COLUMNS, SAMPLES, load_examples, score


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and return the exit status."""
    about, _, more = (__doc__ or "").partition("\n")
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m ia_bench_training.single_view", description=about, epilog=more, formatter_class=style, allow_abbrev=False
    )
    parser.add_argument("examples", nargs="+", help="shipped scenes, scene folders, or folders of held-out shards")
    parser.add_argument("--prior", nargs="+", default=["diffusion"], help="names or module:Class (default: diffusion)")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="an option of every one of them")
    parser.add_argument("--samples", type=at_least(1), default=SAMPLES, help=f"samples whose mean is scored (default: {SAMPLES})")
    parser.add_argument("--seeds", type=at_least(0), nargs="+", default=[0], help="seeds (default: 0)")
    parser.add_argument("--limit", type=at_least(1), help="at most this many images of each")
    wanted = parser.parse_args(arguments)
    return status_of(lambda: _score(wanted))


def _score(wanted: argparse.Namespace) -> int:
    priors = {name: make_prior(name, {}, [f"prior.options.{text}" for text in wanted.option]) for name in wanted.prior}
    geometry = any(not prior.info.wants.isdisjoint({"normals", "visibility"}) for prior in priors.values())
    loaded = [load_examples(name, wanted.limit, geometry=geometry) for name in wanted.examples]
    header = ["prior", "images", *COLUMNS.values()]
    say(f"| {' | '.join(header)} |\n|{' :--- |' * 2}{' ---: |' * len(COLUMNS)}", sys.stdout)
    for (name, prior), examples in product(priors.items(), loaded):
        runs = [score(prior, examples, samples=wanted.samples, seed=seed) for seed in wanted.seeds]
        cells = [_cell([run[column] for run in runs if column in run]) for column in COLUMNS.values()]
        say(f"| {' | '.join([name, f'{examples.name} ({len(examples.albedo)})', *cells])} |", sys.stdout)
    return OK


def _cell(values: list[float]) -> str:
    estimate = over_scenes([values])
    if estimate is None:
        return "–"
    return f"{estimate.mean:.2f}" + ("" if estimate.half_width is None else f" ± {estimate.half_width:.2f}")


if __name__ == "__main__":
    sys.exit(main())
