"""``python -m ia_bench_training.train_refiner``: trains the network that corrects albedo and roughness of fits."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.arguments import read_arguments, settings_text
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.progress import Progress

USAGE = """\
python -m ia_bench_training.train_refiner data=FOLDER validation=FOLDER out=FOLDER [KEY=VALUE ...]

Trains the refiner on fits made by python -m ia_bench_training.fit_data. The same command resumes a run that was stopped.
out/weights holds the averaged weights (prior=refiner prior.options.refiner=out/weights uses them), out/validation.jsonl
the figures.

Settings and their defaults
"""


def usage() -> str:
    """The help text, with every setting."""
    from ia_bench_training.refiner import RefinerSettings  # brings in torch

    return USAGE + settings_text(RefinerSettings)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(usage, _train, arguments)


def _train(arguments: Sequence[str]) -> int:
    from ia_bench_training.refiner import RefinerSettings, train_refiner

    settings = read_arguments(RefinerSettings, arguments)
    with Progress() as progress:
        figures = train_refiner(settings, progress)
        progress.note(f"weights in {settings.out / 'weights'}: {figures}")
    return OK


if __name__ == "__main__":
    sys.exit(main())
