"""Whatever a method gives back that its contract does not allow is one sentence that names it; what it leaves behind is undone."""

import os
import random
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from ia_bench.common.errors import PluginError
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.info import MethodInfo, check_declarations
from ia_bench.methods.validation import checked_reconstruction, checked_result, reconstruct
from ia_bench.render.reconstruction import Assets, Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Scene

ALBEDO, ROUGHNESS, LIGHT = torch.full((4, 4, 3), 0.5), torch.full((4, 4, 1), 0.5), torch.ones(4, 8, 3)


@pytest.fixture(scope="module")
def stage(tiny: Scene) -> Stage:
    return Stage(tiny.expect_mesh(), torch.device("cpu"))


def textured(stage: Stage, albedo: Any = ALBEDO, roughness: Any = ROUGHNESS, light: Any = LIGHT) -> TexturedReconstruction:
    return TexturedReconstruction(stage, Material(albedo, roughness), light)


@dataclass
class Own:
    """A reconstruction of a method's own kind; the parts answer for it."""

    picture: Any = None
    exported: Any = None
    environment: Any = None
    renderer: Any = "own"

    def maps(self, cameras: Any, names: Any, *, points: int) -> Any:
        return self.picture

    def render(self, cameras: Any, **how: Any) -> Any:
        return self.picture

    def assets(self) -> Any:
        return self.exported


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"albedo": ALBEDO * torch.nan}, "albedo: expected finite values, found NaN or Inf in 48 of 48"),
        ({"albedo": ALBEDO.double()}, "albedo: expected type float32, found float64"),
        ({"albedo": ALBEDO[:2]}, r"albedo: expected shape \(T, T, 3\), found \(2, 4, 3\)"),
        ({"albedo": ALBEDO.numpy()}, "albedo: expected a tensor, found ndarray"),
        ({"albedo": ALBEDO.to("meta")}, "albedo: expected device cpu, found meta"),
        ({"albedo": ALBEDO.to_sparse()}, "albedo: expected layout strided, found sparse_coo"),
        ({"albedo": ALBEDO - 1}, "albedo: expected values from 0 to 1, found -0.5 to -0.5"),
        ({"roughness": ROUGHNESS * 20}, "roughness: expected values from 0 to 1, found 10 to 10"),
        ({"light": LIGHT[..., 0]}, r"light: expected shape \(H, 2 H, 3\), found \(4, 8\)"),
        ({"light": LIGHT[:3]}, r"light: expected shape \(H, 2 H, 3\), found \(3, 8, 3\)"),
        ({"light": -LIGHT}, r"light: expected values from 0 to 1e\+12, found -1 to -1"),
        ({"light": LIGHT * 1e38}, r"light: expected values from 0 to 1e\+12, found 1e\+38 to 1e\+38"),
        ({"albedo": ALBEDO.clone().requires_grad_()}, "albedo: expected requires_grad False, found True"),
        ({"albedo": torch.ones(1, 1, 3).expand(36000, 36000, 3)}, "albedo: expected at most 8192 texels a side"),
    ],
)
def test_textures_that_nothing_can_draw(changes: dict[str, Any], message: str, stage: Stage) -> None:
    with pytest.raises(PluginError, match=f"^method mine: reconstruction: {message}"):
        checked_reconstruction("mine", textured(stage, **changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reconstruction": None}, "reconstruction: expected maps, render, .*, found NoneType"),
        ({"reconstruction": Own(renderer=None)}, "reconstruction: expected .* the name of a renderer, found Own"),
        ({"reconstruction": Own(environment="sun")}, "environment: expected radiance.*, found str"),
        ({"seconds": {"fit": float("nan")}}, "seconds: expected names with finite numbers >= 0, found 'fit': nan"),
        ({"seconds": [1.0]}, "seconds: expected a mapping of names to numbers, found list"),
        ({"counters": {"calls": float("nan")}}, "counters: expected names with whole numbers >= 0, found 'calls': nan"),
        ({"counters": {3: 4}}, "counters: expected names with whole numbers >= 0, found 3: 4"),
        ({"seconds": {"score": 1.0}}, "seconds: expected phases of the method's own, found score, which the run books itself"),
        ({"declared": {"seconds": 1}}, "declared: expected a ia_bench.common.declared.Declared or None, found {'seconds': 1}"),
        ({"steps": -1}, "expected names with whole numbers >= 0, found 'steps': -1"),
    ],
)
def test_results_that_say_something_else(changes: dict[str, Any], message: str, stage: Stage) -> None:
    with pytest.raises(PluginError, match=f"^method mine: .*{message}"):
        checked_result("mine", replace(Result(textured(stage)), **changes))


def test_what_is_no_result_and_what_is_one(stage: Stage) -> None:
    for wrong in (None, {"reconstruction": textured(stage)}):
        with pytest.raises(PluginError, match=r"^method mine: fit\(\): expected ia_bench.methods.contract.Result, found"):
            checked_result("mine", wrong)
    sound = checked_result("mine", Result(textured(stage), {"fit": np.float32(2)}, {"calls": np.int64(3)}, 4))
    assert (sound.seconds, sound.counters, sound.steps) == ({"fit": 2.0}, {"calls": 3}, 4)
    assert type(sound.reconstruction) is TexturedReconstruction


def test_answers_are_checked_as_they_are_given(tiny: Scene) -> None:
    cameras = [tiny.test[0].camera]
    picture = np.zeros((32, 32, 3), np.float32)
    images = Images((picture,), (picture[..., 0],))
    sound = Assets(tiny.expect_mesh(), picture, picture[..., 0])

    def maps(found: Any) -> Any:
        return found.maps(cameras, ("albedo",), points=1)

    def render(found: Any) -> Any:
        return found.render(cameras, light=None, albedo_scale=None, quality=Quality(1, 1))

    def assets(found: Any) -> Any:
        return found.assets()

    def asked(of: Callable[[Any], Any], **parts: Any) -> Any:
        return of(checked_reconstruction("mine", Own(**parts)))

    assert asked(render, picture=images) is images
    assert asked(maps, picture={"albedo": images}) == {"albedo": images}
    assert asked(assets, exported=sound) is sound
    assert asked(render) is asked(assets) is asked(lambda found: found.environment) is None
    flat, doubled = Images((picture[..., 0],), images.coverage), Images((picture.astype(int),), images.coverage)
    for of, parts, message in (
        (maps, {}, r"maps\(\): expected a mapping, found NoneType"),
        (maps, {"picture": {"albedo": flat}}, r"maps\(\): albedo: expected images of \[\(32, 32, 3\)\].*, found \[\(32, 32\)\]"),
        (render, {"picture": object()}, r"render\(\): expected .*Images, found object"),
        (render, {"picture": doubled}, r"render\(\): .* found \[\(32, 32, 3\)\] of int64"),
        (assets, {"exported": "textures"}, "expected .*Assets with a mesh, or None, found str"),
        (assets, {"exported": replace(sound, roughness=picture)}, r"roughness: expected shape \(T, T\), found"),
        (assets, {"exported": replace(sound, albedo=picture + np.float32(np.inf))}, "albedo: expected finite values"),
    ):
        with pytest.raises(PluginError, match=f"^method mine: reconstruction.*{message}"):
            asked(of, **parts)


class Careless:
    """A method that changes the process, and says what it saw when it was scored."""

    def __init__(self, stage: Stage, change: Callable[[], object]) -> None:
        self.stage, self.change = stage, change

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        self.change()
        monitor.score("fit", 0, 0.0, lambda: textured(self.stage))
        return Result(textured(self.stage))


def test_what_a_method_changes_for_all_is_put_back(stage: Stage, tiny: Scene) -> None:
    def state() -> list[object]:
        of_torch = torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_rng_state().tolist(), torch.get_default_device()
        return [*of_torch, np.random.get_state()[1].tolist(), random.getstate(), np.geterr(), os.getcwd()]

    def change() -> None:
        torch.set_default_dtype(torch.float64)
        torch.set_grad_enabled(False)
        torch.set_default_device("meta")
        np.seterr(all="raise")
        os.chdir("/")
        for seed in (torch.manual_seed, np.random.seed, random.seed):
            seed(0)
        changed.extend(state())

    before, changed = state(), list[object]()
    reconstruct("careless", Careless(stage, change), Problem(tiny.blind()), seed=0, monitor=Monitor.silent())  # type: ignore[arg-type]
    assert not any(one == other for one, other in zip(before, changed, strict=True))
    assert state() == before


def test_what_is_scored_on_the_way_is_checked_and_a_method_that_leaves_ends_no_run(stage: Stage, tiny: Scene) -> None:
    class Early(Careless):
        def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
            monitor.score("fit", 0, 0.0, lambda: None)  # type: ignore[arg-type,return-value]
            return Result(textured(self.stage))

    monitor = Monitor.silent(score=lambda phase, step, seconds, recovered: recovered())
    with pytest.raises(PluginError, match="^method early: reconstruction: expected .*, found NoneType"):
        reconstruct("early", Early(stage, print), Problem(tiny.blind()), seed=0, monitor=monitor)  # type: ignore[arg-type]
    leaves = Careless(stage, lambda: sys.exit(0))
    with pytest.raises(PluginError, match="^method careless raised SystemExit: 0"):
        reconstruct("careless", leaves, Problem(tiny.blind()), seed=0, monitor=Monitor.silent())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("info", None),
        ("Options", dict),
        ("presets", [1]),
        ("presets", {"a": {"x": 1}}),
        ("info", MethodInfo(uses_prior=False, sees_truth="no")),  # type: ignore[arg-type]
        ("info", MethodInfo(uses_prior=False, brought="none")),  # type: ignore[arg-type]
    ],
)
def test_what_a_class_declares_is_checked_before_it_is_made(part: str, value: object) -> None:
    declared = {"Options": dataclass(type("Options", (), {})), "presets": {}, "info": MethodInfo(uses_prior=False)}
    check_declarations("mine", SimpleNamespace(**declared))
    with pytest.raises(PluginError, match=f"^method mine: {part}: .*expected "):
        check_declarations("mine", SimpleNamespace(**declared | {part: value}))
