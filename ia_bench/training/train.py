"""``python -m ia_bench.training.train``: trains the diffusion prior, or the regressor of the same size."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, INTERRUPTED, OK, complain
from ia_bench.common.progress import Progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    from ia_bench.training.settings import parse, usage

    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if not {"-h", "--help"}.isdisjoint(arguments):
        print(usage(), end="")
        return OK
    try:
        settings = parse(arguments)
        from ia_bench.training.loop import train  # brings in diffusers

        with Progress() as progress:
            figures = train(settings, progress)
            progress.note(f"weights in {settings.out / 'weights'}: {figures}")
    except InputError as error:
        return complain(str(error))
    except FloatingPointError as error:  # a training that gave up has said where, and its last checkpoint is kept
        return complain(str(error), FAULT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK


if __name__ == "__main__":
    sys.exit(main())
