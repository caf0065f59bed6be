"""What a run ran on, stored with its numbers: machine, versions, commit."""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.paths import PACKAGE

PACKAGES = ("ia_bench", "torch", "numpy", "scipy", "scikit-image", "lpips", "embreex", "warp-lang", "trimesh", "xatlas")
"""Distributions whose version can change a number."""
INSTRUCTIONS = {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2", "MKL_CBWR": "COMPATIBLE"}
"""The environment in which torch, oneDNN and MKL compute alike on all x86 processors with AVX2; read when they first compute."""
QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Microseconds of CPU time that a container has in so many microseconds, "max" where there is no limit."""


def environment(device: str, threads: int) -> dict[str, Any]:
    """Machine, versions and commit, as JSON types; ``device`` is "cpu" or "cuda"."""
    if device == "cuda":
        import torch  # only where a run has it loaded anyway

        if torch.cuda.is_available():  # not where a table tells of a worker that died elsewhere
            device = torch.cuda.get_device_name()
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "cpu": _entry("/proc/cpuinfo", "model name", platform.machine()),
        "cores": os.cpu_count(),
        "threads": threads,
        "device": device,
        "memory_bytes": total_memory(),
        "packages": {name: _version(name) for name in PACKAGES},
        "commit": commit(),
    }


def cores() -> int:
    """CPU cores that this process may use: those that it is bound to, or as many as its control group has time for, if fewer."""
    bound = len(os.sched_getaffinity(0))
    limit, _, period = QUOTA.read_text().partition(" ") if QUOTA.is_file() else ("max", "", "")
    return bound if limit == "max" else max(1, min(bound, int(limit) // int(period)))


def load() -> float | None:
    """Programs that ran or waited in the last minute, this one among them, for each core; None where the system does not tell."""
    try:
        return round(os.getloadavg()[0] / (os.cpu_count() or 1), 2)
    except OSError:
        return None


def total_memory() -> int:
    """Memory of this machine in bytes, or of the control group that the process lives in where that is less."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limit = Path("/sys/fs/cgroup/memory.max")
    text = limit.read_text().strip() if limit.is_file() else "max"
    return total if text == "max" else min(total, int(text))


def available_memory(device: str = "cpu") -> int:
    """Bytes that this process may still take: what the machine has free, or what is left of its control group's limit.

    Of a ``device`` "cuda": what is free on the GPU, and what torch holds there without using it.
    """
    if device == "cuda":
        import torch  # only where tensors live there

        return int(torch.cuda.mem_get_info()[0] + torch.cuda.memory_reserved() - torch.cuda.memory_allocated())
    free = 1024 * int(_entry("/proc/meminfo", "MemAvailable").removesuffix("kB")) or total_memory()
    taken, cached = Path("/sys/fs/cgroup/memory.current"), _entry("/sys/fs/cgroup/memory.stat", "file ")
    return min(free, total_memory() - int(taken.read_text()) + int(cached)) if taken.is_file() else free


def expect_memory(setting: str, needed: float, device: str = "cpu") -> None:
    """Raise InputError, before anything is allocated, where ``needed`` bytes for a ``setting`` ("key=value") are not to be had.

    ``device``: "cuda" for what is allocated on the GPU.
    """
    free = available_memory(device)
    if needed > free:
        room = f"the {free / 1e9:.1f} GB of memory that are free{' on the GPU' if device == 'cuda' else ''}"
        raise InputError(f"{setting}: expected to fit into {room}, found a need for {needed / 1e9:.3g} GB")


def return_memory() -> None:
    """Give what this process has freed back to the system, which the C library of Linux keeps in between what is in use."""
    with suppress(OSError, AttributeError, TypeError):  # of another system, whose library has no such function
        ctypes.CDLL(None).malloc_trim(0)


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


def _entry(path: str, name: str, otherwise: str = "0") -> str:
    """What the first line of a file of the system that begins with ``name`` says of it, or ``otherwise`` where there is none."""
    lines = Path(path).read_text().splitlines() if Path(path).is_file() else []
    return next((line.removeprefix(name).strip(" :\t") for line in lines if line.startswith(name)), otherwise)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def instructions() -> list[str]:
    """What the variables of INSTRUCTIONS are set to, "" for one that is not."""
    return [os.environ.get(name, "") for name in INSTRUCTIONS]


def settle_libraries(threads: int) -> None:
    """Make every library of this process use ``threads`` CPU threads and, on x86, the same instructions on every processor.

    By themselves torch, oneDNN and MKL take the newest instructions, and MKL other ones on other makers' processors; sums are then
    rounded otherwise, which a fit amplifies. Variables that the user has set stay.
    """
    os.environ["OMP_NUM_THREADS"] = str(threads)  # for what is not loaded yet, and for child processes
    if "avx2" in _entry("/proc/cpuinfo", "flags").split():
        for name, value in INSTRUCTIONS.items():
            os.environ.setdefault(name, value)
    import torch

    torch.set_num_threads(threads)
