"""What a run says of its scene, and refuses, before its method sees it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Problem
from ia_bench.methods.info import MethodInfo
from ia_bench.methods.monitor import CostTracker
from ia_bench.priors import inputs
from ia_bench.priors.diffusion import learned
from ia_bench.readers.contract import NO_MESH
from ia_bench.runs.composition import compose
from ia_bench.runs.run import problem_of, tell_unused_coupling, without_training_images
from ia_bench.runs.scene import tell
from ia_bench.scenes.scene import Scene
from ia_bench.scenes.turning import TurningLight


def handed(scene: Scene, info: MethodInfo, *overrides: str) -> tuple[Problem, list[str]]:
    """What a method is handed that says this of itself, and what the user is told."""
    notes: list[str] = []
    config = compose(["scene=tiny", *(overrides or ["device=cpu"])])
    return problem_of(config, scene, info, note=notes.append, costs=CostTracker()), notes


def test_a_scene_that_lacks_what_a_method_needs_is_refused(tiny: Scene) -> None:
    bare = replace(tiny, mesh=replace(tiny.mesh, uv=np.zeros_like(tiny.mesh.uv)))
    empty = replace(bare, mesh=replace(bare.mesh, faces=tiny.mesh.faces[:0]))
    nothing, mesh, both = (MethodInfo(uses_prior=False, needs=frozenset(needs)) for needs in ((), ("mesh",), ("mesh", "uv")))
    with pytest.raises(InputError, match="method=two_stage: expected a scene with uv, found none in tiny"):
        handed(bare, both)
    with pytest.raises(InputError, match="expected a scene with mesh and uv, found none in tiny"):
        handed(empty, both)
    for scene, needs in ((tiny, both), (bare, mesh), (empty, nothing)):
        assert handed(scene, needs)[0].scene.name == "tiny"


@pytest.mark.parametrize(
    ("info", "told"),
    [
        (MethodInfo(uses_prior=False), True),
        (MethodInfo(uses_prior=False, fits_exposures=True), False),
        (MethodInfo(uses_prior=False, sees_truth=True), False),
    ],
)
def test_a_method_that_takes_exposures_for_the_same_is_told_of(tiny: Scene, info: MethodInfo, told: bool) -> None:
    _, notes = handed(replace(tiny, exposures_differ=True), info)
    assert [note.startswith("every photograph has an exposure of its own; method=two_stage") for note in notes] == [True] * told
    assert handed(tiny, info)[1] == []


def test_a_light_that_turns_is_told_of_a_method_that_does_not_turn_it_and_reaches_the_others(tiny: Scene) -> None:
    turning = replace(tiny, turning=TurningLight(tuple(map(tuple, tiny.train[0].camera.to_world[:3]))))
    told = ["the light turns with the camera; method=two_stage takes it for one that stands still"]
    for turns, expected in ((False, told), (True, [])):
        problem, notes = handed(turning, MethodInfo(uses_prior=False, turns_light=turns))
        assert (problem.scene.turning, notes) == (turning.turning, expected)


@pytest.mark.parametrize("uses_prior", [False, True])
def test_a_coupling_that_a_method_has_not_asked_for_is_told(tiny: Scene, uses_prior: bool) -> None:
    for coupling, asked, told in (("targets", False, True), ("none", False, False), ("targets", True, False)):
        overrides = "device=cpu", "prior=regressor", f"coupling={coupling}"
        problem, notes = handed(tiny, MethodInfo(uses_prior=uses_prior), *overrides)
        if asked:
            problem.coupling  # noqa: B018 (as a method does)
            notes.clear()  # of what a coupling is to a prior that says nothing
        tell_unused_coupling(compose(["scene=tiny", *overrides]), problem, notes.append)
        assert notes == ["coupling=targets: method=two_stage has not asked for it; it changed nothing"] * told


@pytest.mark.parametrize(("overrides", "expected"), [
    (["device=cpu"], "cpu"), (["device=cuda"], "cuda"), (["device=cpu", "prior.options.device=cuda"], "cuda"),
])  # fmt: skip
@pytest.mark.parametrize("behind", [False, True], ids=["asked", "behind another one"])
def test_a_prior_goes_where_the_run_is_unless_it_is_told_where(
    overrides: list[str], expected: str, behind: bool, tiny: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a machine has is no part of a run's identity, so that a GPU must not have a say in a run on the CPU."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: True)
    monkeypatch.setattr(inputs, "use_bf16", lambda precision, device: device.type == "cuda")
    monkeypatch.setattr(learned, "use_bf16", inputs.use_bf16)
    if behind:
        overrides = [text.replace("options.device", "options.of_options") for text in overrides]
        overrides = [text.replace("of_options=cuda", "of_options={device:cuda}") for text in overrides]
    overrides = [f"prior={'corrected' if behind else 'diffusion'}", *overrides]
    asked = handed(tiny, MethodInfo(uses_prior=True), *overrides)[0].prior
    found = asked.prior.prior if behind else asked  # told the truth, corrected, itself
    options = compose(["scene=tiny", *overrides]).prior.options
    options = options["of_options"] if behind else options
    assert found._device.type == expected
    assert options["precision"] == ("bf16" if expected == "cuda" else "float32")


@pytest.mark.parametrize("made", [True, False])
def test_a_mesh_that_was_made_is_not_said_to_be_missing(tiny: Scene, made: bool) -> None:
    said: list[str] = []
    tell(replace(tiny, notes=(NO_MESH, "another note"), mesh_is_made=made), said.append)
    assert said[0] == ("another note" if made else NO_MESH)
    assert "another note" in said


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (100.0, True), (0.01, True)])
def test_photographs_in_a_unit_that_scores_cannot_see_are_told(tiny: Scene, factor: float, told: bool) -> None:
    novel = tuple(replace(view, image=view.image * np.float32(factor)) for view in tiny.novel)
    said = list[str]()
    tell(replace(tiny, novel=novel), said.append)
    assert any("have a mean radiance of" in line for line in said) == told
    nothing = replace(novel[0], mask=np.zeros_like(novel[0].mask), image=np.zeros_like(novel[0].image))
    said.clear()
    tell(replace(tiny, novel=(nothing, *novel)), said.append)  # a view that shows nothing has no mean
    assert any("have a mean radiance of" in line for line in said) == told


def test_training_images_are_held_once_where_nothing_scores_them(tiny: Scene) -> None:
    """Where there are test views; else pictures show training images, which are then the run's own."""
    given = tiny.blind()
    held, own = without_training_images(tiny, given), without_training_images(replace(tiny, test=(), novel=()), given)
    for view, before, method_s, mine in zip(held.train, tiny.train, given.train, own.train, strict=True):
        assert view.image is method_s.image
        assert view.camera is before.camera is not method_s.camera
        assert mine.image is before.image
        assert view.specular is mine.specular is None
    assert (held.test, held.novel, held.truth) == (tiny.test, tiny.novel, tiny.truth)
