"""Whether one run has the same numbers on other x86 processors, as far as this one can play them.

    python -m benchmarks.processors [OVERRIDE...]           e.g. scene=hat prior=combined

Runs ``ia-bench run threads=1 OVERRIDE...`` (default: scene=tiny preset=smoke) in processes of their own: as it is; as on a
processor without AVX-512, where Embree, numpy, OpenBLAS and the kernels have AVX2 only; and with the instructions that torch,
oneDNN and MKL would choose by themselves. Prints which scores and recovered maps are the same to the bit, and how far aligned
albedo is off.
What it cannot play: caches of other sizes, processors without AVX2, other makers' approximate divisions (Embree's two sets of
instructions divide differently, too).
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

RUN = """
import sys
import warp
from ia_bench.render import rays
instructions, target = sys.argv[1:3]
if instructions:
    library, _ = rays._library()
    device = library.rtcNewDevice(f"isa={instructions}".encode())
    rays._library = lambda: (library, device)
    warp.config.cpu_compiler_flags = warp.config.cpu_compiler_flags.replace("-march=native", f"-target-cpu {target}")
from ia_bench.cli.run import main
sys.exit(main(sys.argv[3:]))
"""
NUMPY = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
AS_IT_IS, WITHOUT_AVX512, BY_THEMSELVES = "as it is", "without AVX-512", "libraries by themselves"
PROCESSORS: dict[str, tuple[dict[str, str], tuple[str, str]]] = {
    AS_IT_IS: ({}, ("", "")),
    WITHOUT_AVX512: ({"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": NUMPY}, ("avx2", "x86-64-v3")),
    BY_THEMSELVES: ({"ATEN_CPU_CAPABILITY": "avx512", "ONEDNN_MAX_CPU_ISA": "ALL", "MKL_CBWR": "AUTO"}, ("", "")),
}
MAPS = ("albedo.exr", "roughness.exr", "light.exr")


def numbers_of(name: str, out: Path, overrides: Sequence[str]) -> tuple[list[str], dict[str, dict[str, float]]]:
    """Hashes of the maps that a run recovers on a processor of PROCESSORS, and its scores."""
    environment, played = PROCESSORS[name]
    environment = os.environ | environment | {"IA_BENCH_CACHE": f"{out}_cache"}  # nothing of what another has made
    command = [sys.executable, "-c", RUN, *played, "threads=1", f"out={out}", *overrides]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    hashes = [hashlib.sha256((out / file).read_bytes()).hexdigest() for file in MAPS]
    return hashes, json.loads((out / "metrics.json").read_text(encoding="utf-8"))["metrics"]


def main() -> None:
    """Run all and print the table."""
    overrides = sys.argv[1:] or ["scene=tiny", "preset=smoke"]
    print(f"{' '.join(overrides)}\n\n| processor | maps | scores | aligned albedo, dB off |\n| :--- | :--- | :--- | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        found = {name: numbers_of(name, Path(folder, name.replace(" ", "_")), overrides) for name in PROCESSORS}
    maps, scores = found[AS_IT_IS]
    for name, (others, theirs) in found.items():
        same = ["the same" if alike else "others" for alike in (others == maps, theirs == scores)]
        print(f"| {name} | {same[0]} | {same[1]} | {theirs['aligned_albedo']['psnr'] - scores['aligned_albedo']['psnr']:+.4f} |")


if __name__ == "__main__":
    main()
