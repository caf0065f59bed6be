"""All methods and priors of the baselines keep their contracts, and what a fit takes is booked, all of it and once."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
import torch

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.methods import check_method
from ia_bench.checks.painted_ball import painted_ball
from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Method, Monitor
from ia_bench.priors.contract import Observations, Prior
from ia_bench.render.reconstruction import Reconstruction, TexturedReconstruction
from ia_bench.scenes.scene import Scene
from ia_bench_baselines import usi3d, yi
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.spherical_gaussians import fit as spherical_gaussians
from ia_bench_baselines.invrender.method import InvRender, InvRenderOptions
from ia_bench_baselines.mitsuba_adam.loop import Loop
from ia_bench_baselines.mitsuba_adam.reconstruction import MitsubaReconstruction
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions
from ia_bench_baselines.neilfpp.method import Neilfpp, NeilfppOptions
from ia_bench_baselines.nvdiffrec.method import Nvdiffrec, NvdiffrecOptions
from ia_bench_baselines.nvdiffrecmc.method import Nvdiffrecmc, NvdiffrecmcOptions
from ia_bench_baselines.retinex.prior import RetinexPrior
from ia_bench_baselines.tensoir.method import Tensoir, TensoirOptions
from ia_bench_baselines.usi3d.prior import Usi3dPrior
from ia_bench_baselines.yi.prior import YiPrior
from tests.baselines.home_ground import problem_of


def mitsuba_adam(steps: int) -> Method:
    """Skips the test where Mitsuba cannot be used."""
    try:
        import_mitsuba(1)
    except InputError as error:
        pytest.skip(str(error))
    from ia_bench_baselines.mitsuba_adam.method import MitsubaAdam

    return MitsubaAdam(MitsubaAdamOptions(steps=steps))


def tensoir(steps: int) -> Method:
    sizes = TensoirOptions(radiance_steps=2, fine_steps=2, pixels=16, radiance_pixels=16, directions=12, coarse=8, fine=12)
    return Tensoir(replace(sizes, coarse_steps=steps))


def neilfpp(steps: int) -> Method:
    sizes = NeilfppOptions(
        surface_light_steps=2, material_steps=2, pixels=16, directions=16, glossy=4, rendered_directions=32, traced=32
    )
    return Neilfpp(replace(sizes, joint_steps=steps, width=16))


def invrender(steps: int) -> Method:
    sizes = InvRenderOptions(radiance_steps=2, indirect_steps=2, pixels=32, texels=32, atlas=32, directions=64, texture=64)
    return InvRender(replace(sizes, steps=steps))


METHODS: dict[str, Callable[[int], Method]] = {
    "invrender": invrender,
    "mitsuba_adam": mitsuba_adam,
    "neilfpp": neilfpp,
    "nvdiffrec": lambda steps: Nvdiffrec(NvdiffrecOptions(steps=steps, pixels=64)),
    "nvdiffrecmc": lambda steps: Nvdiffrecmc(NvdiffrecmcOptions(steps=steps, samples=2)),
    "tensoir": tensoir,
}
"""By name, with so many steps of the longest phase."""
PRIORS: dict[str, Callable[[], Prior]] = {"retinex": RetinexPrior, "usi3d": Usi3dPrior, "yi": YiPrior}
SLOW = 0.25  # seconds that what is made before the first step takes, and everything that is recovered


@dataclass
class Clock:
    """A clock that stands still but for the calls that it slows: how busy the machine is decides nothing."""

    now: float = 0.0

    def slowed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, which takes SLOW seconds."""

        def slow(*given: Any, **named: Any) -> Any:
            self.now += SLOW
            return call(*given, **named)

        return slow


@pytest.mark.parametrize("method", [InvRender, Neilfpp, Nvdiffrec, Nvdiffrecmc, Tensoir])
def test_the_full_preset_takes_four_times_all_steps(method: type[Any]) -> None:
    """As the rows that are called so say."""
    defaults = method.Options()
    full = method.presets["full"]
    assert full == {name: 4 * getattr(defaults, name) for name in full}
    assert full.keys() == {name for name in vars(defaults) if name == "steps" or name.endswith("_steps")}


@pytest.mark.parametrize("name", [name if name == "nvdiffrec" else pytest.param(name, marks=pytest.mark.slow) for name in METHODS])
def test_a_method_keeps_the_contract(name: str, tiny: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spherical_gaussians, "STEPS", 5)  # of lights that are given
    found = list(check_method(lambda: METHODS[name](4), problem_of, tiny))
    assert [finding for finding in found if finding.status != "pass"] == []


def black(scene: Scene) -> Scene:
    return replace(scene, train=tuple(replace(view, image=0 * view.image) for view in scene.train))


def flat(scene: Scene) -> Scene:
    mesh = scene.expect_mesh()
    return replace(scene, mesh=replace(mesh, vertices=mesh.vertices * np.array([1, 1, 0], np.float32)))


STARTS = {
    "black photographs": (lambda: invrender(2), black),
    "a flat mesh": (lambda: tensoir(2), flat),
    "all of metal at first": (
        lambda: Nvdiffrecmc(NvdiffrecmcOptions(steps=2, samples=2, metallic_initial=1.0)),
        lambda scene: scene,
    ),
}


@pytest.mark.parametrize(("make", "changed"), STARTS.values(), ids=STARTS)
def test_no_step_is_skipped(make: Callable[[], Method], changed: Callable[[Scene], Scene], tiny: Scene) -> None:
    found = make().fit(problem_of(changed(tiny)), seed=0, monitor=Monitor.silent())
    assert found.counters["skipped_steps"] == 0


@pytest.mark.parametrize("name", PRIORS)
def test_a_prior_keeps_the_contract(name: str) -> None:
    assert [finding for finding in check_prior(PRIORS[name], painted_ball(20, 24, 3)) if finding.status == "fail"] == []


@pytest.mark.parametrize("image", [0.0, 1e6])
@pytest.mark.parametrize("name", PRIORS)
def test_black_and_bright_pictures_and_an_empty_mask_give_finite_samples(name: str, image: float) -> None:
    images, masks = torch.full((2, 6, 5, 3), image), torch.ones(2, 6, 5)
    masks[1] = 0
    found = PRIORS[name]().sample(Observations(images * masks[..., None], masks), seed=0).values
    assert all(bool(torch.isfinite(values).all()) and float(values[1].abs().max()) == 0 for values in found.values())


@pytest.mark.parametrize("prior", [yi.prior, usi3d.prior], ids=["yi", "usi3d"])
def test_the_packaged_weights_are_those_that_the_code_names(prior: Any) -> None:
    """A run is not repeated while its prior's code is the same: who packages other weights must say so in the code."""
    made = {yi.prior: YiPrior, usi3d.prior: Usi3dPrior}[prior]
    assert sha256(made.packaged().read_bytes()).hexdigest() == prior.WEIGHTS


@pytest.mark.parametrize("name", METHODS)
def test_all_seconds_of_a_fit_are_booked_once(name: str, tiny: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(time, "perf_counter", lambda: clock.now)
    for part in (TrainingPixels, Loop, TexturedReconstruction, MitsubaReconstruction):
        monkeypatch.setattr(part, "__init__", clock.slowed(part.__init__))
    problem, scores = problem_of(tiny), []

    def score(phase: str, step: int, seconds: float, recovered: Callable[[], Reconstruction]) -> None:
        with problem.costs.exclude("score"):  # as a run does
            scores.append(recovered())

    result = METHODS[name](27).fit(problem, seed=0, monitor=Monitor.silent(score=score))
    seconds, booked = dict(result.seconds), problem.costs.seconds
    assert not seconds.keys() & booked.keys(), "in metrics.json one would take the other's place"
    assert len(scores) == 1
    assert booked["score"] >= SLOW, "what is recovered to be scored is no cost of the fit"
    assert sum(seconds.values()) + sum(booked.values()) == clock.now > SLOW, (seconds, booked)
