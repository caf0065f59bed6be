"""What pictures a page has: plain data, so that a page without any needs no renderer."""

from __future__ import annotations

import hashlib
import shutil
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ia_bench.runs.config import slug

TRUTH = "truth"
"""The folder of a scene's true pictures."""
NOT_ROWS = (TRUTH, "photograph")
"""What the page calls pictures that are no row's."""
KEY = "drawn.json"
"""What a folder of pictures is known by."""


@dataclass
class Gallery:
    """What was drawn.

    Attributes:
        scenes: Scene -> what the page has to know to show its pictures (JSON types).
        missing: A sentence for each scene or row that has no pictures.
    """

    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    @property
    def relit(self) -> bool:
        """Whether any scene has a light that no method has seen."""
        return any(scene["lights"] for scene in self.scenes.values())


def folder_names(names: Collection[str], taken: Collection[str] = ()) -> dict[str, str]:
    """A folder name for each of different names: their slug, and a checksum of the name where that is not one name's alone.

    ``taken``: folder names that are not to be had. Upper and lower case make no difference, as on some disks.
    """
    counted = Counter(slug(name).casefold() for name in names)
    found = {}
    for name in names:
        short = slug(name)
        alone = counted[short.casefold()] == 1 and short.casefold() not in taken and short.strip(".")
        found[name] = short if alone else f"{short}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return found


def take_down_others(gallery: Gallery, parts: Path) -> None:
    """Remove the pictures in the folder ``parts`` of scenes that are not in the gallery, as a former report has left them."""
    hung = {scene["folder"] for scene in gallery.scenes.values()}
    for marked in list(parts.glob(f"*/{TRUTH}/{KEY}")):
        if marked.parents[1].name not in hung:
            shutil.rmtree(marked.parents[1], ignore_errors=True)
