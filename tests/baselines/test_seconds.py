"""What a fit of a baseline takes is booked, all of it and once: setup, steps, scores in between, what is recovered in the end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from ia_bench.checks.methods import Killed, Memory
from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Method, Monitor
from ia_bench.render.reconstruction import Reconstruction, TexturedReconstruction
from ia_bench.scenes.scene import Scene
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.invrender.method import InvRender
from ia_bench_baselines.invrender.settings import InvRenderOptions
from ia_bench_baselines.mitsuba_adam.loop import Loop
from ia_bench_baselines.mitsuba_adam.reconstruction import MitsubaReconstruction
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions
from ia_bench_baselines.neilfpp.method import Neilfpp
from ia_bench_baselines.neilfpp.settings import NeilfppOptions
from ia_bench_baselines.nvdiffrec.method import Nvdiffrec
from ia_bench_baselines.nvdiffrec.settings import NvdiffrecOptions
from ia_bench_baselines.nvdiffrecmc.method import Nvdiffrecmc
from ia_bench_baselines.nvdiffrecmc.settings import NvdiffrecmcOptions
from ia_bench_baselines.tensoir.method import Tensoir
from ia_bench_baselines.tensoir.settings import TensoirOptions
from tests.baselines.home_ground import problem_of


def mitsuba_adam() -> Method:
    """Skips the test where Mitsuba cannot be used."""
    try:
        import_mitsuba(1)
    except InputError as error:
        pytest.skip(str(error))
    from ia_bench_baselines.mitsuba_adam.method import MitsubaAdam

    return MitsubaAdam(MitsubaAdamOptions(steps=27))


METHODS: dict[str, Callable[[], Method]] = {
    "invrender": lambda: InvRender(
        InvRenderOptions(radiance_steps=2, indirect_steps=2, steps=27, pixels=32, texels=32, atlas=32, directions=64, texture=64)
    ),
    "mitsuba_adam": mitsuba_adam,
    "neilfpp": lambda: Neilfpp(
        NeilfppOptions(surface_light_steps=2, material_steps=2, joint_steps=27, pixels=16, directions=16, traced=32)
    ),
    "nvdiffrec": lambda: Nvdiffrec(NvdiffrecOptions(steps=27, pixels=64)),
    "nvdiffrecmc": lambda: Nvdiffrecmc(NvdiffrecmcOptions(steps=27, samples=2)),
    "tensoir": lambda: Tensoir(
        TensoirOptions(radiance_steps=2, coarse_steps=27, fine_steps=2, pixels=16, radiance_pixels=16, rows=4, coarse=8, fine=12)
    ),
}
SLOW = 0.3  # seconds that are added to what is made before the first step, and to everything that is recovered


def slowed(call: Callable[..., Any]) -> Callable[..., Any]:
    """The same call, which takes SLOW seconds more."""

    def slow(*given: Any, **named: Any) -> Any:
        time.sleep(SLOW)
        return call(*given, **named)

    return slow


@pytest.mark.parametrize("name", METHODS)
def test_all_seconds_of_a_fit_are_booked_once(name: str, tiny: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    METHODS[name]().fit(problem_of(tiny), seed=0, monitor=Monitor.silent())  # what is imported and compiled is no part of a fit
    for part in (TrainingPixels, Loop, TexturedReconstruction, MitsubaReconstruction):
        monkeypatch.setattr(part, "__init__", slowed(part.__init__))
    problem, scores = problem_of(tiny), []

    def score(phase: str, step: int, seconds: float, recovered: Callable[[], Reconstruction]) -> None:
        with problem.costs.exclude("score"):  # as a run does
            scores.append(recovered())

    started = time.perf_counter()
    result = METHODS[name]().fit(problem, seed=0, monitor=Monitor.silent(score=score))
    passed = time.perf_counter() - started
    seconds, booked = dict(result.seconds), problem.costs.seconds
    assert not seconds.keys() & booked.keys(), "in metrics.json one would take the other's place"
    assert len(scores) == 1
    assert booked["score"] >= SLOW, "what is recovered to be scored is no cost of the fit"
    assert 0.93 * passed <= sum(seconds.values()) + sum(booked.values()) <= passed * (1 + 1e-6), (seconds, booked, passed)


@pytest.mark.parametrize("name", ["nvdiffrec", "nvdiffrecmc"])
def test_a_resumed_fit_does_not_look_for_a_start(name: str, tiny: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = Memory(deadly=True)
    with pytest.raises(Killed):
        METHODS[name]().fit(problem_of(tiny), seed=0, monitor=memory.monitor())
    memory.deadly, drawn = False, []
    draw = TrainingPixels.draw
    monkeypatch.setattr(TrainingPixels, "draw", lambda *given: drawn.append(1) or draw(*given))
    METHODS[name]().fit(problem_of(tiny), seed=0, monitor=memory.monitor())
    steps_left = {"nvdiffrec": 25, "nvdiffrecmc": 0}  # of 27; those of nvdiffrecmc draw no pixels, but whole photographs
    assert len(drawn) == steps_left[name]
