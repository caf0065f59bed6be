"""The check of methods: one that keeps the contract passes, and each way of breaking it is named."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.checks import methods
from ia_bench.checks.finding import Finding, difference
from ia_bench.checks.methods import check_method, with_other_truth
from ia_bench.cli.check import main
from ia_bench.common.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.info import MethodInfo
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.settings import RenderSettings
from ia_bench.runs import scene as scenes
from ia_bench.runs.config import RunConfig
from ia_bench.scenes.scene import Scene


@pytest.fixture(autouse=True)
def coarse_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = methods.Protocol
    monkeypatch.setattr(methods, "Protocol", lambda: replace(plain(), map_points=1, render_points=1, samples_per_pixel=4))


@pytest.fixture(scope="module")
def tiny(tiny: Scene) -> Scene:
    """`tiny` with fewer views to score: two of the test, one of each light."""
    by_light = {view.light: view for view in tiny.novel}
    return replace(tiny, test=tiny.test[:2], novel=tuple(by_light.values()))


@dataclass(frozen=True)
class Options:
    steps: int = 3


class Walk:
    """Random steps of one grey; what it breaks is in its subclasses."""

    Options = Options
    presets = {"smoke": {"steps": 2}}
    info = MethodInfo(uses_prior=False)
    saves = True
    forgets = False

    def __init__(self, options: Options) -> None:
        self.options = options

    def start(self, seed: int) -> torch.Generator:
        return torch.Generator().manual_seed(seed)

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        generator, step, grey = self.start(seed), 0, torch.tensor(0.5)
        state = monitor.load()
        if state is not None and not self.forgets:
            step, grey = state["step"], state["grey"]
            generator.set_state(state["generator"])
        while step < self.options.steps:
            grey = (grey + 0.1 * torch.randn((), generator=generator)).clamp(0.1, 0.9)
            step += 1
            if self.saves and monitor.stopping():
                monitor.save({"step": step, "grey": grey, "generator": generator.get_state()})
        return self.result(problem, grey)

    def result(self, problem: Problem, grey: torch.Tensor) -> Any:
        material = Material(grey * torch.ones(4, 4, 3), torch.full((4, 4, 1), 0.5))
        return Result(TexturedReconstruction(problem.stage, material, torch.ones(8, 16, 3)), {"walk": 0.1}, {}, self.options.steps)


def findings(method: type, tiny: Scene, problem: Callable[[Scene], Problem] | None = None) -> dict[str, Finding]:
    def hand_over(scene: Scene) -> Problem:
        return Problem(scene.blind(), RenderSettings(bounces=0))

    return {finding.what: finding for finding in check_method(lambda: method(Options()), problem or hand_over, tiny)}


def failed(found: dict[str, Finding]) -> list[str]:
    return [what for what, finding in found.items() if finding.status == "fail"]


def test_what_keeps_the_contract_passes_and_what_never_saves_is_told_so(tiny: Scene) -> None:
    found = findings(Walk, tiny)
    assert failed(found) == []
    assert {finding.status for finding in found.values()} == {"pass"}
    assert found["killed and resumed"].found == ""
    assert {f"score of {name}" for name in Walk.info.predicts} <= set(found)
    found = findings(type("Saveless", (Walk,), {"saves": False}), tiny)
    assert failed(found) == []
    assert found["killed and resumed"].status == "skip"


def test_a_scene_that_lacks_truth_and_test_views_is_no_fault_of_the_method(tiny: Scene) -> None:
    found = findings(Walk, replace(tiny, test=(), truth=replace(tiny.truth, lights={}, albedo=None, roughness=None)))
    assert failed(found) == []
    assert {what: finding.found for what, finding in found.items() if finding.status == "skip"} == {
        "score of albedo": "no test views",
        "score of roughness": "no test views",
        "score of relighting": f"no environment map of {', '.join(sorted({view.light for view in tiny.novel} - {'train'}))}",
    }


def test_what_forgets_its_checkpoint_is_found(tiny: Scene) -> None:
    """It starts again with the checkpoint of another random state, which a resumed process has."""

    class Forgetful(Walk):
        def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
            return super().fit(problem, seed=seed + (monitor.load() is not None), monitor=monitor)

        forgets = True

    assert failed(findings(Forgetful, tiny)) == ["killed and resumed"]


def test_what_draws_nan_when_it_is_resumed_is_found(tiny: Scene) -> None:
    class Unsound(Walk):
        def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
            result = super().fit(problem, seed=seed, monitor=monitor)
            if monitor.load() is not None:
                result.reconstruction.render = Dark().render
            return result

    assert failed(findings(Unsound, tiny)) == ["killed and resumed"]


@pytest.mark.parametrize("generator", [torch.Generator().manual_seed(7), torch.default_generator], ids=["own", "of the process"])
def test_what_does_not_repeat_is_found(generator: torch.Generator, tiny: Scene) -> None:
    """It goes on where it ended; the numbers of the process's generator would be those of whatever ran before."""
    broken = type("Restless", (Walk,), {"start": lambda self, seed: generator, "saves": False})
    assert failed(findings(broken, tiny)) == ["the same seed again", "the same seed again, with another truth"]


def test_what_finds_the_truth_is_found(tiny: Scene) -> None:
    """The problem looks blind, and the truth comes by another door."""
    hidden: list[Scene] = []

    class Peeping(Walk):
        def start(self, seed: int) -> torch.Generator:
            return torch.Generator().manual_seed(int(1000 * hidden[-1].truth.albedo.mean()))

        saves = False

    def hand_over(scene: Scene) -> Problem:
        hidden.append(scene)
        return Problem(scene.blind(), RenderSettings(bounces=0))

    assert failed(findings(Peeping, tiny, hand_over)) == ["the same seed again, with another truth"]


def test_another_truth_is_another_one_in_every_part(tiny: Scene) -> None:
    known = replace(tiny, truth=replace(tiny.truth, metallic=tiny.truth.roughness, mesh=tiny.mesh))
    before, after = vars(known.truth), vars(with_other_truth(known).truth)
    assert [name for name in before if difference(before[name], after[name]) is None] == []


def test_what_writes_to_the_scene_is_found(tiny: Scene) -> None:
    class Painter(Walk):
        def result(self, problem: Problem, grey: torch.Tensor) -> Result:
            problem.scene.train[0].image[0, 0] = 1
            return super().result(problem, grey)

    class Believer(Walk):
        def result(self, problem: Problem, grey: torch.Tensor) -> Result:
            problem.scene.train[0].valid[:] = True
            return super().result(problem, grey)

    eight_bits = captured(tiny, CaptureSettings(radiometry="ldr", percentile=90.0), lambda line: None)
    for method, scene in ((Painter, tiny), (Believer, eight_bits)):
        assert failed(findings(method, scene)) == ["the scene"]


class Dark:
    """A reconstruction that predicts less than its method says, and that wrongly."""

    renderer, environment = "night", None

    def maps(self, cameras: Any, names: Any, *, points: int) -> dict[str, Any]:
        return {}

    def render(self, cameras: Any, **_: Any) -> Any:
        shapes = [(camera.height, camera.width) for camera in cameras]
        return methods.Images(tuple(np.full((*s, 3), np.nan) for s in shapes), tuple(np.ones(s) for s in shapes))

    def assets(self) -> None:
        return None


def test_what_is_declared_and_not_there_is_found(tiny: Scene) -> None:
    found = findings(type("Night", (Walk,), {"result": lambda self, problem, grey: Result(Dark(), steps=1)}), tiny)
    assert {"map of albedo", "map of roughness", "render under its own light", "score of albedo"} <= set(failed(found))
    assert "not finite" in found["render under its own light"].found


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"Options": dict}, "Options, presets and info"),
        ({"__init__": lambda self, options: 1 / 0}, "Options, presets and info"),
        ({"info": "fast"}, "Options, presets and info"),
        ({"fit": lambda self, scene: None}, "a fit"),
        ({"result": lambda self, problem, grey: {"albedo": grey}}, "a fit"),
        ({"result": lambda self, problem, grey: Result(grey)}, "a fit"),
        ({"start": lambda self, seed: 1 / 0}, "a fit"),
    ],
)
def test_what_is_no_method_is_found(changes: dict[str, Any], what: str, tiny: Scene) -> None:
    assert failed(findings(type("Broken", (Walk,), changes), tiny)) == [what]


def test_the_command(tiny_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = [f"method={__name__}:Walk", "threads=1", f"scene.path={tiny_folder}"]
    assert main(here) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"method {__name__}:Walk ({__name__}:Walk) on scene tiny"
    assert lines[-1] == f"{len(lines) - 2} passed, 0 failed, 0 skipped"


def test_the_command_fits_on_the_cpu_where_there_is_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two fits on a GPU are never the same to the bit, which would be held against the method."""
    devices = []

    def stop(config: RunConfig, note: object) -> None:
        devices.append(config.device)
        raise InputError("far enough")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(scenes, "captured_scene", stop)
    assert main(["method=two_stage"]) == 2
    assert devices == ["cpu"]
