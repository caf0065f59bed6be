"""``python -m ia_bench_training.train_refiner``: trains the network that corrects albedo and roughness of fits."""

from __future__ import annotations

import sys

from ia_bench.common.arguments import settings_text
from ia_bench.common.progress import Progress
from ia_bench_training.commands import command_of
from ia_bench_training.refiner import RefinerSettings, train_refiner

USAGE = """\
python -m ia_bench_training.train_refiner data=FOLDER validation=FOLDER out=FOLDER [KEY=VALUE ...]

Trains the refiner on fits made by python -m ia_bench_training.fit_data. The same command resumes a run that was stopped.
out/weights holds the averaged weights (prior=refiner prior.options.refiner=out/weights uses them), out/validation.jsonl
the figures.

Settings and their defaults
"""


def _train(settings: RefinerSettings, progress: Progress) -> None:
    progress.note(f"weights in {settings.out / 'weights'}: {train_refiner(settings, progress)}")


main = command_of(USAGE + settings_text(RefinerSettings), RefinerSettings, _train)


if __name__ == "__main__":
    sys.exit(main())
