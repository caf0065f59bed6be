"""Does a method keep the contract of :mod:`ia_bench.methods.contract`? One finding per question, with what was found.

It reconstructs a small scene as a run would have it do: twice with one seed, the second time with another truth behind the scene,
and once more, killed at a checkpoint and resumed by a new instance. What it recovered is asked for everything that the
method says it predicts, and scored.
"""

from __future__ import annotations

import inspect
import io
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any

import numpy as np
import torch
from scipy.ndimage import maximum_filter
from torch import Tensor

from ia_bench.checks.blindness import leaks, with_other_truth
from ia_bench.checks.finding import Finding, judge
from ia_bench.common.errors import raised
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.info import PREDICTED, MethodInfo
from ia_bench.readers.contract import unscored
from ia_bench.render.reconstruction import Assets, Quality, Reconstruction
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

QUALITY, SEED, VIEWS = Quality(points=2, samples=16), 0, 2  # of the pictures that are looked at; scores have the protocol's
KILLED = "killed and resumed"
TOLERANCE = 1e-3  # beyond [0, 1]: interpolation and antialiasing
COMPONENTS = {"albedo": ("albedo", "aligned_albedo"), "roughness": ("roughness",)}  # of scores, where they have other names


Fit = Callable[[Scene, "Memory"], Reconstruction]


class Killed(BaseException):
    """The end of the process in the middle of a fit."""


class Memory:
    """What outlives a process: the monitor's side of checkpoints, held as the bytes that a file would hold.

    ``deadly``: the process is told to stop when it asks for the second time, and ends with its next checkpoint.
    """

    def __init__(self, *, deadly: bool = False) -> None:
        self.state: bytes | None = None
        self.deadly = deadly
        self._parts: dict[str, bytes] = {}
        self._asked = 0

    def monitor(self) -> Monitor:
        """What a process is given that starts with this memory."""
        return Monitor.silent(
            save=self._save,
            load=lambda: None if self.state is None else _unpacked(self.state),
            stopping=self._stopping,
            keep=lambda name, state: self._parts.update({name: _packed(state)}),
            kept=lambda name: _unpacked(self._parts[name]) if name in self._parts else None,
        )

    def _stopping(self) -> bool:
        self._asked += 1
        return self.deadly and self._asked > 1

    def _save(self, state: dict[str, Any]) -> None:
        self.state = _packed(state)
        if self.deadly:
            raise Killed


def check_method(make: Callable[[], Any], make_problem: Callable[[Scene], Problem], scene: Scene) -> Iterator[Finding]:
    """Check the method that ``make()`` returns; an instance for every fit. Never raises for what the method does.

    ``make_problem``: makes a problem of a scene that has its truth, as ``scene`` has, just as a run does.
    """
    try:
        method = make()
    except (Exception, SystemExit) as error:
        yield Finding("fail", "construction", "an object", raised(error))
        return
    members = list(_members(method))
    yield from members
    if any(finding.status == "fail" for finding in members):
        yield Finding("skip", "everything else", "", "it needs the members above")
        return
    problem, started = make_problem(scene), time.perf_counter()
    before = _digest(problem.scene)
    yield _blind(method.info, problem, scene)
    try:
        result = method.fit(problem, seed=SEED, monitor=Memory().monitor())
    except (Exception, SystemExit) as error:
        yield Finding("fail", "a fit", "no exception", raised(error))
        return
    seconds = time.perf_counter() - started
    findings = list(_result(result))
    yield from findings
    same = _digest(problem.scene) == before
    yield judge(same, "the scene", "nothing modified", "nothing" if same else "images, masks, cameras or mesh modified")
    if any(finding.status == "fail" for finding in findings):
        yield Finding("skip", "everything else", "", "it needs a sound result")
        return
    cameras = [view.camera for view in (scene.test or scene.novel or scene.train)[:VIEWS]]

    def fit(scene: Scene, memory: Memory) -> Reconstruction:
        found: Reconstruction = make().fit(make_problem(scene), seed=SEED, monitor=memory.monitor()).reconstruction
        return found

    rules: tuple[tuple[str, Callable[[], Iterator[Finding]]], ...] = (
        ("what it predicts", lambda: _predicted(method.info, result.reconstruction, cameras)),
        ("the same seed again", lambda: _repeated(fit, problem, scene, result.reconstruction, cameras)),
        (KILLED, lambda: _resumed(fit, scene, result.reconstruction, cameras)),
        ("scores", lambda: _scored(method.info, result.reconstruction, scene)),
    )
    for title, rule in rules:
        try:
            yield from rule()
        except (Exception, SystemExit) as error:
            yield Finding("fail", title, "no exception", raised(error))
    yield Finding("pass", "a fit", "", f"{seconds:.1f} s, of {result.steps} steps")


# ---- members and result ----------------------------------------------------------------------------------------------


def _members(method: Any) -> Iterator[Finding]:  # noqa: ANN401 (anything may claim to be a method)
    parts: list[Any] = [getattr(method, name, None) for name in ("Options", "presets", "info")]
    options, presets, info = parts
    named = getattr(options, "__name__", repr(options))
    yield judge(isinstance(options, type) and is_dataclass(options), "Options", "a dataclass", named)
    names = isinstance(presets, Mapping) and all(isinstance(changes, Mapping) for changes in presets.values())
    shown = ", ".join(map(str, presets)) or "none" if names else repr(presets)
    yield judge(names, "presets", "a mapping of names to options that differ from their defaults", shown)
    sound = isinstance(info, MethodInfo) and info.predicts <= PREDICTED
    predicts = ", ".join(sorted(info.predicts)) if sound else repr(info)
    yield judge(sound, "info", f"a MethodInfo that predicts some of {', '.join(sorted(PREDICTED))}", predicts)
    signature = "fit(problem, *, seed, monitor)"
    try:
        inspect.signature(method.fit).bind("problem", seed=0, monitor=None)
    except (AttributeError, TypeError) as error:
        yield Finding("fail", "fit", signature, str(error))
    else:
        yield Finding("pass", "fit", signature, f"fit{inspect.signature(method.fit)}")


def _blind(info: MethodInfo, problem: Problem, scene: Scene) -> Finding:
    if info.sees_truth:
        return Finding("skip", "what it is handed", "", "it declares that it sees the truth")
    found = leaks(problem, scene)
    return judge(not found, "what it is handed", "no way to the truth", ", ".join(found) or "none")


def _result(result: Any) -> Iterator[Finding]:  # noqa: ANN401 (whatever the method returned)
    if not isinstance(result, Result):
        yield Finding("fail", "a result", "a Result", type(result).__name__)
        return
    found = result.reconstruction
    members = isinstance(found, Reconstruction) and isinstance(found.renderer, str) and bool(found.renderer)
    yield judge(members, "a reconstruction", "maps, render, assets, environment and the name of a renderer", type(found).__name__)
    times = all(isinstance(value, float) and value >= 0 for value in result.seconds.values())
    yield judge(times, "seconds", "phase -> seconds", f"{dict(result.seconds)}")
    counts = all(isinstance(value, int) for value in (result.steps, *result.counters.values()))
    yield judge(counts, "steps and counters", "whole numbers", f"{result.steps} steps, {dict(result.counters)}")


# ---- what was recovered ----------------------------------------------------------------------------------------------


def _predicted(info: MethodInfo, found: Reconstruction, cameras: list[Camera]) -> Iterator[Finding]:
    maps = found.maps(cameras, ("albedo", "roughness"), points=QUALITY.points)
    for name, channels in (("albedo", (3,)), ("roughness", ())):
        if name in info.predicts:
            yield _sound(f"map of {name}", maps.get(name), cameras, channels, 1 + TOLERANCE)
    if "view_synthesis" in info.predicts:
        yield _sound("render under its own light", _render(found, cameras, None), cameras, (3,), math.inf)
    if "relighting" in info.predicts:
        relit = _render(found, cameras, _sky(), torch.tensor([0.9, 1.0, 1.1]))
        if relit is None and found.assets() is not None:
            yield Finding("pass", "render under another light", "", "none: the reference renderer draws its textures")
        else:
            yield _sound("render under another light", relit, cameras, (3,), math.inf)
    if found.environment is not None:
        yield _environment(found.environment)
    assets = found.assets()
    if assets is not None:
        yield _assets(assets)


def _sound(what: str, images: Images | None, cameras: list[Camera], channels: tuple[int, ...], most: float) -> Finding:
    shapes = [(camera.height, camera.width, *channels) for camera in cameras]
    expected = f"images of {shapes[0]}, finite, >= 0" + (" and <= 1" if math.isfinite(most) else "")
    if images is None:
        return Finding("fail", what, expected, "none, though info.predicts it")
    found = [image.shape for image in images.images]
    values = np.concatenate([image.ravel() for image in images.images])
    bad, text = int((~np.isfinite(values)).sum()), f"{found[0] if found else 'no image'}, {values.min():.3g} ... {values.max():.3g}"
    fits = found == shapes and not bad and values.min() >= -TOLERANCE and values.max() <= most
    far = [maximum_filter(cover, 3) == 0 for cover in images.coverage]  # a pixel away, for a renderer's own pixel filter
    outside = max(float(np.abs(image[empty]).max(initial=0)) for image, empty in zip(images.images, far, strict=True))
    return judge(fits and outside < TOLERANCE, what, expected, f"{text}, {bad} not finite, up to {outside:.2g} outside the object")


def _environment(environment: Any) -> Finding:  # noqa: ANN401 (whatever the method returned)
    expected = "radiance(directions (N, 3)) -> (N, 3) and latlong(8) -> (8, 16, 3), finite, >= 0"
    if not isinstance(environment, Environment):
        return Finding("fail", "environment", expected, type(environment).__name__)
    directions = torch.nn.functional.normalize(torch.randn(5, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    found = (environment.radiance(directions), environment.latlong(8))
    sound = all(bool(torch.isfinite(value).all() and (value >= 0).all()) for value in found)
    shapes = [tuple(value.shape) for value in found]
    found_text = f"{shapes}, {'sound' if sound else 'unsound'} values"
    return judge(sound and shapes == [(5, 3), (8, 16, 3)], "environment", expected, found_text)


def _assets(assets: Assets) -> Finding:
    side = len(assets.albedo)
    shapes = {"albedo": (side, side, 3), "roughness": (side, side), "metallic": (side, side)}
    arrays = {name: getattr(assets, name) for name in (*shapes, "light") if getattr(assets, name) is not None}
    fits = all(np.isfinite(array).all() and array.min() >= 0 for array in arrays.values())
    fits = fits and all(array.shape == shapes.get(name, array.shape) for name, array in arrays.items())
    found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
    return judge(fits, "assets", "square textures of one size and a light, finite, >= 0", found)


def _render(found: Reconstruction, cameras: list[Camera], light: Environment | None, scale: Tensor | None = None) -> Images | None:
    return found.render(cameras, light=light, albedo_scale=scale, quality=QUALITY)


def _sky() -> Environment:
    return LatLongEnvironment(torch.linspace(1, 0.2, 8)[:, None, None].expand(8, 16, 3).contiguous())


# ---- once more -------------------------------------------------------------------------------------------------------


def _repeated(fit: Fit, problem: Problem, scene: Scene, first: Reconstruction, cameras: list[Camera]) -> Iterator[Finding]:
    what = "the same seed again"
    if problem.truth is not None or ("prior" in vars(problem) and problem.prior.info.sees_truth):
        yield _same(what, first, fit(scene, Memory()), cameras)
        return
    blind = _same(f"{what}, with another truth", first, fit(with_other_truth(scene), Memory()), cameras)
    if blind.status == "fail":  # because of the truth, or because no two fits are the same?
        yield _same(what, first, fit(scene, Memory()), cameras)
    yield blind


def _resumed(fit: Fit, scene: Scene, whole: Reconstruction, cameras: list[Camera]) -> Iterator[Finding]:
    memory = Memory(deadly=True)
    try:
        fit(scene, memory)
    except Killed:
        memory.deadly = False
        yield _same(KILLED, whole, fit(scene, memory), cameras)
    else:
        why = "it saves nothing when it is told to stop: one that is interrupted begins again"
        yield Finding("skip", KILLED, "", why) if memory.state is None else judge(False, KILLED, "an end", "a fit that went on")


def _same(what: str, first: Reconstruction, again: Reconstruction, cameras: list[Camera]) -> Finding:
    pairs = zip(_pictures(first, cameras), _pictures(again, cameras), strict=True)
    largest = max((float(np.abs(one - other).max(initial=0)) for one, other in pairs), default=0.0)
    found = "the same" if largest == 0 else f"pictures that differ by up to {largest:.3g}"
    return judge(largest == 0, what, "the same reconstruction to the bit", found)


def _pictures(found: Reconstruction, cameras: list[Camera]) -> Iterator[np.ndarray]:
    for images in (*found.maps(cameras, ("albedo", "roughness"), points=QUALITY.points).values(), _render(found, cameras, None)):
        yield from () if images is None else images.images
    if found.environment is not None:
        yield found.environment.latlong(16).cpu().numpy()


def _scored(info: MethodInfo, found: Reconstruction, scene: Scene) -> Iterator[Finding]:
    metrics, lacking = Scorer(scene, Protocol(), torch.device("cpu")).full(found).metrics, unscored(scene)
    yield from (Finding("skip", f"score of {name}", "", lacking[name]) for name in sorted(info.predicts & lacking.keys()))
    for name in sorted(info.predicts - lacking.keys()):
        values = {f"{part} {metric}": value for part in COMPONENTS.get(name, (name,)) for metric, value in metrics[part].items()}
        text = ", ".join(f"{metric} {'undefined' if value is None else f'{value:.3g}'}" for metric, value in values.items())
        yield judge(None not in values.values(), f"score of {name}", "numbers", text)


# ---- helpers ---------------------------------------------------------------------------------------------------------


def _digest(scene: Scene) -> list[bytes]:
    arrays = [array for view in scene.train for array in (view.image, view.mask, view.valid, view.camera.to_world)]
    mesh = () if scene.mesh is None else vars(scene.mesh).values()
    return [array.tobytes() for array in (*arrays, *mesh) if array is not None]


def _packed(state: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def _unpacked(content: bytes) -> dict[str, Any]:
    """What is no tensor, number, text, list or dict of them is refused, as by a run."""
    return torch.load(io.BytesIO(content), weights_only=True)
