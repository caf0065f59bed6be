"""Every kernel compiles for CUDA, for which no device is needed; what a GPU computes, only a machine with one can test."""

import importlib
from pathlib import Path

import pytest
import warp as wp

import ia_bench

ROOT = Path(ia_bench.__file__).parent
WITH_KERNELS = sorted(path for path in ROOT.rglob("*.py") if "@wp.kernel" in path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", WITH_KERNELS, ids=lambda path: path.stem)
def test_kernels_compile_for_cuda(path: Path, tmp_path: Path) -> None:
    module = importlib.import_module(".".join(("ia_bench", *path.relative_to(ROOT).with_suffix("").parts)))
    wp.compile_aot_module(module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert list(tmp_path.glob("*.ptx"))
