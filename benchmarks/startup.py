"""CPU seconds from the command to the end of a fit's first step, by phase: with an empty cache, and with a full one.

    python benchmarks/startup.py [--rounds N] [OVERRIDE...]

OVERRIDEs are those of ``ia-bench run``, ``scene=hat`` if there are none. Every start is a process of its own, and medians of
the rounds are shown. A phase's seconds are its own, without those of a phase inside it; a package's import counts as its own
wherever it stands. The kernels are compiled already: on a new machine the first start of all waits for that.
"""

from __future__ import annotations

import argparse
import builtins
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from importlib import import_module
from statistics import median
from typing import Any

FIRST_STEP = "first step"
PHASES = {
    "ia_bench.runs.composition:resolved": "settings checked",
    "ia_bench.runs.execute:identity": "identity",
    "ia_bench.runs.run:read_scene": "scene",
    "ia_bench.runs.scene:check_agreement": "mesh and masks",
    "ia_bench.methods.contract:make_plan": "plan",
    "ia_bench.render.stage:trace_gbuffer": "G-buffers",
    "ia_bench.render.stage:bake_interreflection": "indirect light",
    "ia_bench.methods.two_stage.losses:neighbouring_pixels": "neighbours",
    "ia_bench.methods.two_stage.fit:initial_albedo": "start",
    "ia_bench.methods.two_stage.fit:start_light": "start",
    "ia_bench.methods.two_stage.fit:TwoStageFit._step": FIRST_STEP,
}
PACKAGES = ("torch", "warp", "trimesh", "scipy", "hydra")


class Stopwatch:
    """CPU seconds of phases, each without those that ran inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._phases, self._since = ["rest"], 0.0  # from the start of the process on

    def _turn(self) -> None:
        now = time.process_time()
        self.seconds[self._phases[-1]] += now - self._since
        self._since = now

    def timed(self, phase: str, action: Callable[..., Any]) -> Callable[..., Any]:
        """``action``, whose seconds are counted for ``phase``."""

        def run(*arguments: object, **named: object) -> Any:  # noqa: ANN401 (of any function)
            self._turn()
            self._phases.append(phase)
            try:
                return action(*arguments, **named)
            finally:
                self._turn()
                self._phases.pop()
                if phase == FIRST_STEP:
                    print(json.dumps(self.seconds), flush=True)
                    os._exit(0)

        return run


def start(overrides: list[str]) -> None:
    """Run ``ia-bench run`` in this process up to its first step, print seconds by phase as JSON, and exit."""
    watch, plain, wanted = Stopwatch(), builtins.__import__, dict(PHASES)

    def importing(name: str, *rest: Any, **named: Any) -> object:  # noqa: ANN401 (as the built-in function has them)
        package = name.partition(".")[0]
        label = f"import of {package if package in PACKAGES else 'others'}"
        inside = rest[3:] > (0,)  # a relative import is a part of the one that asks for it
        found = (plain if inside or name in sys.modules else watch.timed(label, plain))(name, *rest, **named)
        for place, phase in list(wanted.items()):  # what is loaded now is watched before anybody takes it
            module, _, function = place.partition(":")
            owner, _, attribute = function.rpartition(".")
            holder = getattr(sys.modules.get(module), owner, None) if owner else sys.modules.get(module)
            if hasattr(holder, attribute):
                del wanted[place]
                setattr(holder, attribute, watch.timed(phase, getattr(holder, attribute)))
        return found

    builtins.__import__ = importing
    import_module("ia_bench.cli.run").main(overrides)


def measure(overrides: list[str], cache: str) -> dict[str, float]:
    """One start with the cache in a folder."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, __file__, "--start", f"out={out}/run", *overrides]
        ran = subprocess.run(command, env={**os.environ, "IA_BENCH_CACHE": cache}, check=True, stdout=subprocess.PIPE, text=True)
    seconds: dict[str, float] = json.loads(ran.stdout.splitlines()[-1])
    return {**seconds, "total": sum(seconds.values())}


def main() -> None:
    """Print a table of phases."""
    if sys.argv[1:2] == ["--start"]:
        return start(sys.argv[2:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", default=["scene=hat"], metavar="OVERRIDE", help="of ia-bench run")
    parser.add_argument("--rounds", type=int, default=3)
    wanted = parser.parse_args()
    rounds: list[tuple[dict[str, float], dict[str, float]]] = []
    for _ in range(wanted.rounds):
        with tempfile.TemporaryDirectory() as cache:
            rounds.append((measure(wanted.overrides, cache), measure(wanted.overrides, cache)))
    print("| phase | empty cache | full cache |\n| :--- | ---: | ---: |")
    for phase in sorted(rounds[0][0], key=lambda phase: rounds[0][0][phase]):
        empty, full = (median(pair[which].get(phase, 0.0) for pair in rounds) for which in (0, 1))
        print(f"| {phase} | {empty:.2f} | {full:.2f} |")


if __name__ == "__main__":
    main()
