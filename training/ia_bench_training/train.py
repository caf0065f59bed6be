"""``python -m ia_bench_training.train``: trains the diffusion prior, or the regressor of the same size."""

from __future__ import annotations

import sys

from ia_bench.common.arguments import settings_text
from ia_bench.common.progress import Progress
from ia_bench_training.commands import command_of
from ia_bench_training.settings import TrainSettings

USAGE = """\
python -m ia_bench_training.train data=FOLDER validation=FOLDER out=FOLDER [KEY=VALUE ...]
torchrun --nproc_per_node 2 -m ia_bench_training.train ...                (several processes or GPUs)

Trains a prior on shards made by python -m ia_bench_training.prior_data. The same command resumes a run that was stopped.
network.kind=regressor trains the deterministic alternative of the same size. out/weights holds the averaged weights
(prior.options.weights=out/weights uses them), out/tensorboard the curves and pictures.

Settings and their defaults
"""


def _train(settings: TrainSettings, progress: Progress) -> None:
    from ia_bench_training.loop import train  # brings in diffusers

    figures = train(settings, progress)
    if figures:
        progress.note(f"weights in {settings.out / 'weights'}: {figures}")


main = command_of(USAGE + settings_text(TrainSettings), TrainSettings, _train)


if __name__ == "__main__":
    sys.exit(main())
