"""Which real data training may see: what datasets/real lists as free, but for what is closed because results are measured on it.

A file is known by its SHA-256, wherever it lies and whatever it is called.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ia_bench.common.errors import InputError

LISTS = Path(__file__).resolve().parents[2] / "datasets" / "real"
NON_COMMERCIAL = "it is non-commercial (sources_nc.toml)"


def open_files(paths: Iterable[Path]) -> list[Path]:
    """Those of ``paths`` that training may see."""
    return [path for path in paths if why_closed(path) is None]


def expect_open(path: Path) -> Path:
    """``path``; raises InputError for a file that training must not see, or that no list names."""
    why = why_closed(path)
    if why is not None:
        raise InputError(f"{path}: expected real data that is open to training, found a file that is not: {why}")
    return path


def why_closed(path: Path) -> str | None:
    """Why training must not see the file; None where it may."""
    return _closed(LISTS).get(hashlib.sha256(path.read_bytes()).hexdigest(), "datasets/real/sums.sha256 does not list it")


def closed_set(name: str) -> list[str]:
    """The files, below the folder of real data, that are closed for one use alone: "scans", or "held_out" without these."""
    parts, mine = _parts(LISTS), dict[str, str]()
    for _, path in _sums(LISTS / "sums.sha256"):
        part = next((part for part in parts if path.startswith(tuple(part["files"]))), {})
        mine[path] = part.get("set", "")
    return sorted(path for path, found in mine.items() if found == name)


def _parts(lists: Path) -> list[dict[str, Any]]:
    if not lists.is_dir():
        raise InputError(f"{lists}: expected the lists of a checkout of what training may see, found none (real=none needs none)")
    return list(tomllib.loads((lists / "sources.toml").read_text("utf-8"))["closed"])


@cache
def _closed(lists: Path) -> Mapping[str, str | None]:
    """SHA-256 (hex) of every listed file -> why it is closed, None for one that is open."""
    reasons = {name: part["why"] for part in _parts(lists) for name in part["files"]}
    found: dict[str, str | None] = {}
    for digest, path in _sums(lists / "sums.sha256"):
        found[digest] = found.get(digest) or next((why for name, why in reasons.items() if path.startswith(name)), None)
    return found | {digest: NON_COMMERCIAL for digest, _ in _sums(lists / "sums_nc.sha256")}


def _sums(path: Path) -> list[list[str]]:
    return [line.split("  ", 1) for line in path.read_text("utf-8").splitlines()]
