"""Whether torch compiles, which takes a C++ compiler."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Literal


def compiles(asked: bool | Literal["auto"], what: str, notice: Callable[[str], None]) -> bool:
    """Resolve a setting: "auto" is yes where a C++ compiler is found, and else says so in one line that names ``what``."""
    if asked != "auto":
        return asked
    found = bool(shutil.which("g++") or shutil.which("clang++"))
    if not found:
        notice(f"{what} is not compiled, and slower: no C++ compiler found for torch.compile")
    return found
