"""The scene of a configuration: its reader made, its files read, and what came back checked."""

from __future__ import annotations

from ia_bench.common.errors import InputError
from ia_bench.common.registry import create
from ia_bench.readers.contract import SceneReader, check_scene
from ia_bench.runs.config import NATIVE_READER, ReaderConfig, SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene


def open_scene(scene: SceneConfig, reader: ReaderConfig) -> SceneReader:
    """The reader, made for the scene; nothing is read yet. Raises InputError for one that cannot be used, or is no reader."""
    made = create("reader", reader.name, reader.target, reader.options, resolve_scene_folder(scene, reader))
    if not isinstance(made, SceneReader):
        raise InputError(f"reader={reader.name}: expected a class with read(truth), found {type(made).__name__} without")
    return made


def read_scene(scene: SceneConfig, reader: ReaderConfig, *, truth: bool) -> Scene:
    """The scene, checked. Raises InputError for what is wrong with it, naming a reader that is not ours."""
    found = open_scene(scene, reader).read(truth)
    try:
        return check_scene(found, truth=truth)
    except (InputError, AttributeError, TypeError, ValueError, IndexError) as error:  # all but the first: parts that are no arrays
        if reader.target == NATIVE_READER:
            raise
        said = error if isinstance(error, InputError) else f"expected what a Scene describes, found other parts ({error})"
        raise InputError(f"reader={reader.name}: {said}") from error
