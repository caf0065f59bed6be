"""Every format of others' data, written once."""

from pathlib import Path

import pytest
from layouts import LAYOUTS, scene_to_write

from ia_bench.readers.writers.parts import Options
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory, tiny: Scene) -> dict[str, tuple[Path, Options]]:
    """The scene `tiny` in every format; read only."""
    folders = {}
    for layout in LAYOUTS:
        folder = tmp_path_factory.mktemp(layout.id) / "tiny"
        folders[layout.id] = folder, layout.write(folder, scene_to_write(tiny))
    return folders
