"""``python -m ia_bench_training.train``: trains the diffusion prior, or the regressor of the same size."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.arguments import read_arguments, settings_text
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress

USAGE = """\
python -m ia_bench_training.train data=FOLDER validation=FOLDER out=FOLDER [KEY=VALUE ...]
torchrun --nproc_per_node 2 -m ia_bench_training.train ...                (several processes or GPUs)

Trains a prior on shards made by python -m ia_bench_training.prior_data. The same command resumes a run that was stopped.
network.kind=regressor trains the deterministic alternative of the same size. out/weights holds the averaged weights
(prior.options.weights=out/weights uses them), out/tensorboard the curves and pictures.

Settings and their defaults
"""


def usage() -> str:
    """The help text, with every setting."""
    from ia_bench_training.settings import TrainSettings  # brings in torch

    return USAGE + settings_text(TrainSettings)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(usage, _train, arguments)


def _train(arguments: Sequence[str]) -> int:
    from ia_bench_training.loop import train  # brings in diffusers
    from ia_bench_training.settings import TrainSettings

    settings = read_arguments(TrainSettings, arguments)
    with Progress() as progress:
        figures = train(settings, progress)
        if figures:
            progress.note(f"weights in {settings.out / 'weights'}: {figures}")
    return OK


if __name__ == "__main__":
    sys.exit(main())
