"""The views of a scene by split, in words: photographs that are both test and novel views are held out once."""

from __future__ import annotations

from collections.abc import Mapping

from ia_bench.scenes.scene import Scene, View

HELD_OUT = "held-out"


def splits(scene: Scene) -> dict[str, tuple[View, ...]]:
    """The views of each split by its name, without empty ones.

    A capture of one light has no other novel views than its test views: they are one split then, HELD_OUT.
    """
    if scene.test and [_identity(view) for view in scene.test] == [_identity(view) for view in scene.novel]:
        found = {"train": scene.train, HELD_OUT: scene.test}
    else:
        found = {"train": scene.train, "test": scene.test, "novel": scene.novel}
    return {name: views for name, views in found.items() if views}


def counted(scene: Scene, shown: Mapping[str, int] | None = None) -> str:
    """How many views of each split there are, such as "17 train, 3 held-out views"; ``shown``: how many of them a picture has."""
    said = []
    for name, views in splits(scene).items():
        part = (shown or {}).get(name, len(views))
        said.append(f"{len(views)} {name}" + (f" ({part} of {len(views)} shown)" if part < len(views) else ""))
    return f"{', '.join(said)} views"


def _identity(view: View) -> tuple[str, bytes, bytes]:
    return view.light, view.camera.to_world.tobytes(), view.image.tobytes()
