"""That libraries compute alike on all processors."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ASK = """
from ia_bench.common.machine import settle_libraries
settle_libraries(1)
import os
import torch
print(torch.get_num_threads(), torch.backends.cpu.get_cpu_capability(), os.environ.get("MKL_CBWR"))
"""


@pytest.mark.skipif("avx2" not in Path("/proc/cpuinfo").read_text(), reason="no AVX2 here")
@pytest.mark.parametrize(("given", "expected"), [({}, "1 AVX2 COMPATIBLE"), ({"MKL_CBWR": "AUTO"}, "1 AVX2 AUTO")])
def test_libraries_take_the_same_instructions_unless_the_user_says_which(given: dict[str, str], expected: str) -> None:
    ours = {"ATEN_CPU_CAPABILITY", "ONEDNN_MAX_CPU_ISA", "MKL_CBWR"}
    environment = {name: value for name, value in os.environ.items() if name not in ours} | given
    asked = subprocess.run([sys.executable, "-c", ASK], check=True, env=environment, capture_output=True, text=True)
    assert asked.stdout.strip() == expected
