"""A native folder that is changed in one place, and how it is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ia_bench.common.errors import InputError
from ia_bench.readers.contract import check_scene
from ia_bench.readers.native import NativeReader


def edit_json(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def refused(folder: Path, *parts: str, truth: bool = False) -> None:
    """The scene is refused in one line that holds all of ``parts`` (regular expressions)."""
    with pytest.raises(InputError) as caught:
        check_scene(NativeReader(folder).read(truth=truth), truth=truth)
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert re.search(part, message), f"{part!r} is not in {message!r}"
