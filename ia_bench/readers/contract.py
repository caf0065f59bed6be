"""What a reader of scenes is, and the check of what it returns, where it enters: one file per format of others' data."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from ia_bench.scenes.scene import Scene


@runtime_checkable
class SceneReader(Protocol):
    """A format of scenes, made by ``Reader(path, **options)``.

    ``path`` is the folder that ``scene.path`` names, absolute and there, or None where the user gave none: a reader that keeps
    or computes its data elsewhere needs none. ``options`` are ``reader.options``, checked against the signature of the class.
    """

    def read(self, truth: bool) -> Scene:
        """The scene, equal at every call; without ``truth``, no file that only truth needs is opened."""
        ...
