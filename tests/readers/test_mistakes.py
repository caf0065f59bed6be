"""Typical mistakes in folders of every format: each is told in one sentence, by the reader or by the check of mesh and masks.

A case spoils a folder that test_round_trips.py reads as it should be read, and says what has to be said of it. What pixels
cannot tell (docs/datasets.md lists it for each reader) is no case. To add one, write a line in the table of its format.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from calibrated_mistakes import MISTAKES as CALIBRATED
from nerf_mistakes import MISTAKES as WITH_FRAMES
from test_round_trips import LAYOUTS, read
from written import Layout, scene_to_write

from ia_bench.common.errors import InputError
from ia_bench.render.agreement import check_agreement
from ia_bench.scenes.scene import Scene

MISTAKES = WITH_FRAMES | CALIBRATED


def said_of(layout: Layout, folder: Path, mesh: Path) -> str:
    """What a run is told of the folder: the one error, or all notes."""
    notes: list[str] = []
    try:
        scene = read(layout, folder, mesh)
        notes += scene.notes
        check_agreement(scene, notes.append)
    except InputError as error:
        return f"error: {error}"
    return "\n".join(notes)


CASES = [(one, mistake) for one in LAYOUTS for mistake in MISTAKES[one.id]]


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory, tiny: Scene) -> dict[str, Path]:
    """The scene `tiny` in every format, with what lies beside its folder; read only."""
    places = {}
    for layout in LAYOUTS:
        places[layout.id] = tmp_path_factory.mktemp(f"sound_{layout.id}")
        layout.write(places[layout.id] / "tiny", scene_to_write(tiny))
    return places


@pytest.mark.parametrize(("layout", "mistake"), CASES, ids=[f"{one.id}-{mistake}" for one, mistake in CASES])
def test_a_typical_mistake_is_told(layout: Layout, mistake: str, sound: dict[str, Path], tmp_path: Path, tiny_folder: Path) -> None:
    spoil, says = MISTAKES[layout.id][mistake]
    folder = Path(shutil.copytree(sound[layout.id], tmp_path / "place")) / "tiny"
    spoil(folder)
    said = said_of(layout, folder, tiny_folder / "mesh.ply")
    assert re.search(says, said), said
    assert "\n" not in said or not said.startswith("error")


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.id)
def test_nothing_is_said_of_a_sound_folder(layout: Layout, sound: dict[str, Path], tiny_folder: Path) -> None:
    said = said_of(layout, sound[layout.id] / "tiny", tiny_folder / "mesh.ply")
    assert "warning" not in said
    assert "expected" not in said
