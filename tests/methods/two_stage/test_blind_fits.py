"""A run hands its method no truth, and records of the two-stage trainer say what it took."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from small_fit import SETTINGS, Record, altered, fit

from ia_bench.common.errors import Fault
from ia_bench.common.progress import Progress
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.info import MethodInfo
from ia_bench.methods.truth_seers import Ceiling
from ia_bench.priors.contract import NoPrior
from ia_bench.render import renderer as renderer_module
from ia_bench.runs import interruption
from ia_bench.runs.composition import compose
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.identity import identity, labels
from ia_bench.runs.run import run


class Reached(Fault):
    """Carries what a method was given out of run.py, which lets a fault pass."""


class Spying(Ceiling):
    """A method that stops the run and shows what it was given."""

    info = MethodInfo(uses_prior=True)

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        raise Reached(problem)


def test_run_hands_a_method_a_blind_scene(tmp_path: Path) -> None:
    config = compose(["scene=tiny", "preset=smoke", "device=cpu", "threads=1", f"method={__name__}:Spying"])
    folder, progress = RunFolder(tmp_path / "run", {}, "0"), Progress(io.StringIO())
    with folder, progress, pytest.raises(Reached) as reached:
        run(config, folder, progress, labels(config, identity(config)))
    (problem,) = reached.value.args
    assert problem.truth is None
    assert (problem.scene.truth, problem.scene.test, problem.scene.novel) == (None, (), ())
    assert {view.albedo is None and view.specular is None for view in problem.scene.train} == {True}
    assert not {"stage", "plan", "gbuffer", "renderer"} & vars(problem).keys() - {"stage"}  # nothing is made unasked
    assert isinstance(problem.prior, NoPrior)


@pytest.mark.parametrize(
    ("image_loss", "samples", "taken"), [("dual_buffer", 24, 32), ("dual_buffer", 8, 16), ("l1", 24, 24), ("l1", 1, 8)]
)
def test_so_many_are_sampled(problem: Problem, image_loss: str, samples: int, taken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of pixels with 2 x 2 points; a step draws as many as the record says."""
    drawn, original = [], renderer_module.draw_samples

    def spy(*arguments: object, points: int, count: int, **parts: int) -> object:
        drawn.append(2 * points * count)
        return original(*arguments, points=points, count=count, **parts)

    monkeypatch.setattr(renderer_module, "draw_samples", spy)
    settings = replace(SETTINGS, stage1_steps=1, stage2_steps=0, image_loss=image_loss, albedo_start=0.0)
    found = fit(altered(problem, plan=replace(problem.plan, samples=samples)), NoPrior(), settings, record := Record())
    assert found.counters["samples_per_pixel"] == taken == drawn[-1] * (2 if image_loss == "dual_buffer" else 1)
    assert (f"render.samples={samples}: steps take {taken} a pixel" in " ".join(record.notes)) == (samples != taken)


@pytest.mark.slow
def test_a_resumed_run_costs_what_both_parts_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed after some steps: rays and points of the whole are counted once, and the seconds before count too."""
    config = compose(["scene=tiny", "preset=smoke", "device=cpu", "threads=1", "prior=oracle"])
    slept = 1000.0  # seconds more than the first process says that it took

    class Killed(BaseException):
        pass

    class Dying(RunFolder):
        def save_checkpoint(self, state: dict[str, Any]) -> None:
            costs = {**state["costs"], "total": state["costs"]["total"] + slept}
            super().save_checkpoint({**state, "costs": costs})
            raise Killed

    def costs(folder: RunFolder) -> tuple[int, float, float]:
        with folder:
            found = run(config, folder, Progress(io.StringIO()), labels(config, identity(config)))
        return found.rays, found.counters["points"], found.time_s["total"]

    rays, points, _ = costs(RunFolder(tmp_path / "whole", {}, "0"))
    dying, stops = Dying(tmp_path / "killed", {}, "0"), iter([False] * 6)
    monkeypatch.setattr(interruption, "asked", lambda: next(stops, True))
    with pytest.raises(Killed):
        costs(dying)
    monkeypatch.undo()
    resumed = costs(RunFolder(tmp_path / "killed", {}, "0"))
    assert resumed[:2] == (rays, points)
    assert resumed[2] > slept
