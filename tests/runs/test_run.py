"""What a run refuses before its method sees the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.methods.books import Books
from ia_bench.methods.info import MethodInfo
from ia_bench.runs.composition import compose
from ia_bench.runs.run import ask_for_the_same_numbers, problem_of
from ia_bench.scenes.scene import Scene


def handed(scene: Scene, needs: frozenset[str]) -> Scene:
    """The scene that a method with these needs is handed."""
    config = compose(["device=cpu", "prior=none", "scene=tiny"])
    info = MethodInfo(uses_prior=False, needs=needs)
    return problem_of(config, scene, info, note=lambda _: None, books=Books()).scene


def test_a_scene_that_lacks_what_a_method_needs_is_refused(tiny: Scene) -> None:
    bare = replace(tiny, mesh=replace(tiny.mesh, uv=np.zeros_like(tiny.mesh.uv)))
    empty = replace(bare, mesh=replace(bare.mesh, faces=tiny.mesh.faces[:0]))
    both = frozenset({"mesh", "uv"})
    with pytest.raises(InputError, match="method=two_stage: expected a scene with uv, found none in tiny"):
        handed(bare, both)
    with pytest.raises(InputError, match="expected a scene with mesh and uv, found none in tiny"):
        handed(empty, both)
    assert handed(tiny, both).name == handed(bare, frozenset({"mesh"})).name == handed(empty, frozenset()).name == "tiny"


@pytest.mark.parametrize(
    ("info", "told"),
    [
        (MethodInfo(uses_prior=False), True),
        (MethodInfo(uses_prior=False, fits_exposures=True), False),
        (MethodInfo(uses_prior=False, sees_truth=True), False),
    ],
)
def test_a_method_that_takes_exposures_for_the_same_is_told_of(tiny: Scene, info: MethodInfo, told: bool) -> None:
    notes: list[str] = []
    config = compose(["scene=tiny", "prior=none", "method=two_stage"])
    problem_of(config, replace(tiny, exposures_differ=True), info, note=notes.append, books=Books())
    assert [note.startswith("every photograph has an exposure of its own; method=two_stage") for note in notes] == [True] * told
    problem_of(config, tiny, info, note=notes.append, books=Books())
    assert len(notes) == told


@pytest.mark.parametrize(("device", "asked"), [("cpu", True), ("cuda", False)])
def test_the_same_numbers_are_asked_for_where_they_are_to_be_had(device: str, asked: bool) -> None:
    before = torch.get_deterministic_debug_mode(), torch.utils.deterministic.fill_uninitialized_memory
    try:
        ask_for_the_same_numbers(device)
        assert torch.are_deterministic_algorithms_enabled() == asked
        assert not torch.is_deterministic_algorithms_warn_only_enabled()
    finally:
        torch.set_deterministic_debug_mode(before[0])
        torch.utils.deterministic.fill_uninitialized_memory = before[1]
