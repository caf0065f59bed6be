"""The scene of a configuration: its reader made, its files read, and what came back checked."""

from __future__ import annotations

from collections.abc import Callable

from ia_bench.capture.capture import captured
from ia_bench.common.errors import InputError, PluginError
from ia_bench.common.registry import at_work, create
from ia_bench.readers.contract import NO_MESH, SceneReader, check_scene, unscored
from ia_bench.render.agreement import check_agreement
from ia_bench.runs.config import NATIVE_READER, ReaderConfig, RunConfig, SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene


def open_scene(scene: SceneConfig, reader: ReaderConfig) -> SceneReader:
    """The reader, made for the scene; nothing is read yet. Raises InputError for one that cannot be used, or is no reader."""
    made = create("reader", reader.name, reader.target, reader.options, resolve_scene_folder(scene, reader))
    if not isinstance(made, SceneReader):
        raise InputError(f"reader={reader.name}: expected a class with read(truth), found {type(made).__name__} without")
    return made


def read_scene(scene: SceneConfig, reader: ReaderConfig, *, truth: bool) -> Scene:
    """The scene, checked. Raises InputError for what is wrong with it, naming a reader that is not ours."""
    opened = open_scene(scene, reader)
    with at_work("reader", reader.name):
        found = opened.read(truth)
    try:
        return check_scene(found, truth=truth)
    except (InputError, AttributeError, TypeError, ValueError, IndexError) as error:  # all but the first: parts that are no arrays
        if reader.target == NATIVE_READER:
            raise
        said = error if isinstance(error, InputError) else f"expected what a Scene describes, found other parts ({error})"
        raise PluginError(f"reader={reader.name}: {said}") from error


def captured_scene(config: RunConfig, note: Callable[[str], None]) -> Scene:
    """The scene of a run with its truth, as the run's capture takes it. Raises InputError for what it cannot."""
    return captured(read_scene(config.scene, config.reader, truth=True), config.capture, note)


def tell(scene: Scene, note: Callable[[str], None], *, aligned: bool = True) -> None:
    """Note what the reader mended, whether mesh and images agree, and what cannot be scored. Raises InputError if they do not.

    ``aligned``: whether the protocol aligns albedo to the truth before it is relit.
    """
    for line in scene.notes:
        if not (scene.mesh_is_made and line == NO_MESH):  # which is why one was made
            note(line)
    if scene.mesh is not None:
        check_agreement(scene, note)
    for component, reason in unscored(scene, aligned=aligned).items():
        note(f"{component} will not be scored: {reason}")
