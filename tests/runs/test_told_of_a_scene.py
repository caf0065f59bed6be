"""What a run says of its scene before it begins."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ia_bench.readers.contract import NO_MESH
from ia_bench.runs.scene import tell
from ia_bench.scenes.scene import Scene


@pytest.mark.parametrize("made", [True, False])
def test_a_mesh_that_was_made_is_not_said_to_be_missing(tiny: Scene, made: bool) -> None:
    said: list[str] = []
    tell(replace(tiny, notes=(NO_MESH, "another note"), mesh_is_made=made), said.append)
    assert said[0] == ("another note" if made else NO_MESH)
    assert "another note" in said
