"""What pictures a page has: plain data, so that a page without any needs no renderer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


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
