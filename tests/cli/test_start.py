"""What a run imports before its first step: nothing that takes long and is not needed yet."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NETWORKS, TABLES = ("diffusers", "lpips", "torchvision", "transformers"), ("matplotlib", "networkx", "pandas")
LATER = (*NETWORKS, *TABLES, "scipy", "skimage", "trimesh")
FIRST_STEP = f"""
import os, sys
import ia_bench.methods.two_stage.fit as fit
plain = fit.TwoStageFit._step
def step(self, *given):
    plain(self, *given)
    print("loaded:", *(name for name in {LATER} if name in sys.modules), flush=True)
    os._exit(0)
fit.TwoStageFit._step = step
from ia_bench.cli.run import main
main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_first_step_needs_few_packages(tmp_path: Path) -> None:
    """With a full cache; without one the mesh is read by trimesh, and its atlas made with scipy."""
    told, settings = [], ("scene=tiny", "preset=smoke", "render.bounces=1", "threads=1")
    for out in ("first", "second"):
        command = [sys.executable, "-c", FIRST_STEP, *settings, f"out={tmp_path / out}"]
        environment = {**os.environ, "IA_BENCH_CACHE": str(tmp_path / "cache")}
        told.append(subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.splitlines()[-1])
    assert {"scipy", "trimesh"} <= set(told[0].split())
    assert told[1].strip() == "loaded:"
