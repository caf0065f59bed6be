"""The reader that a configuration names, on the scene that it names."""

from __future__ import annotations

from ia_bench.common.errors import InputError
from ia_bench.common.registry import create
from ia_bench.readers.contract import SceneReader
from ia_bench.runs.config import ReaderConfig, SceneConfig, resolve_scene_folder


def open_scene(scene: SceneConfig, reader: ReaderConfig) -> SceneReader:
    """The reader, made for the scene; nothing is read yet. Raises InputError for one that cannot be used, or is no reader."""
    made = create("reader", reader.name, reader.target, reader.options, resolve_scene_folder(scene, reader))
    if not isinstance(made, SceneReader):
        raise InputError(f"reader={reader.name}: expected a class with read(truth), found {type(made).__name__} without")
    return made
