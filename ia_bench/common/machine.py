"""What a run ran on, stored with its numbers: machine, versions, commit."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.paths import PACKAGE

PACKAGES = ("ia_bench", "torch", "numpy", "scipy", "scikit-image", "lpips", "embreex", "warp-lang", "trimesh", "xatlas")
"""Distributions whose version can change a number."""


def environment(device: str, threads: int) -> dict[str, Any]:
    """Machine, versions and commit, as JSON types; ``device`` is "cpu" or "cuda"."""
    if device == "cuda":
        import torch  # only where a run has it loaded anyway

        device = torch.cuda.get_device_name()
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "threads": threads,
        "device": device,
        "memory_bytes": total_memory(),
        "packages": {name: _version(name) for name in PACKAGES},
        "commit": commit(),
    }


def total_memory() -> int:
    """Memory of this machine in bytes, or of the control group that the process lives in where that is less."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limit = Path("/sys/fs/cgroup/memory.max")
    text = limit.read_text().strip() if limit.is_file() else "max"
    return total if text == "max" else min(total, int(text))


def available_memory() -> int:
    """Bytes that this process may still take: what the machine has free, or what is left of its control group's limit."""
    meminfo, group = Path("/proc/meminfo"), Path("/sys/fs/cgroup")
    lines = meminfo.read_text().splitlines() if meminfo.is_file() else []
    free = next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), total_memory())
    current, stat = group / "memory.current", group / "memory.stat"
    if not (current.is_file() and stat.is_file()):
        return free
    cached = next((int(line.split()[1]) for line in stat.read_text().splitlines() if line.startswith("file ")), 0)
    return min(free, total_memory() - int(current.read_text()) + cached)


def expect_memory(setting: str, needed: float) -> None:
    """Raise InputError, before anything is allocated, where ``needed`` bytes for a ``setting`` ("key=value") are not to be had."""
    free = available_memory()
    if needed > free:
        room = f"the {free / 1e9:.1f} GB of memory that are free"
        raise InputError(f"{setting}: expected to fit into {room}, found a need for {needed / 1e9:.3g} GB")


def commit() -> str | None:
    """The checkout's git commit, with "+changes" where the source differs from it; None outside a checkout."""
    if not (PACKAGE.parent / ".git").exists():
        return None
    git = ("git", "-C", str(PACKAGE.parent))
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
        sources = ["ia_bench", "conf"]
        changes = subprocess.run([*git, "status", "--porcelain", *sources], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):  # no git, or no commit yet
        return None
    return head.stdout.strip() + ("+changes" if changes.stdout else "")


def _cpu_model() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.is_file() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def limit_threads(threads: int) -> None:
    """Make every library of this process use ``threads`` CPU threads."""
    os.environ["OMP_NUM_THREADS"] = str(threads)  # for what is not loaded yet, and for child processes
    import torch

    torch.set_num_threads(threads)
