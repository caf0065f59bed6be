"""Does a method keep the contract of :mod:`ia_bench.methods.contract`? One finding per question, with what was found.

It reconstructs a small scene as a run would have it do: twice with one seed, the second time with another truth behind the scene,
and once more, killed at a checkpoint and resumed by a new instance. What it recovered is asked for everything that the
method says it predicts, and scored.
"""

from __future__ import annotations

import io
import itertools
import math
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.ndimage import maximum_filter

from ia_bench.checks.finding import Finding, difference, guarded, judge, other_chance, told
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.info import MethodInfo, check_declarations
from ia_bench.methods.validation import reconstruct
from ia_bench.readers.contract import TRUTH_OF_VIEWS, unscored
from ia_bench.render.reconstruction import Quality, Reconstruction
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Scene, View
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

QUALITY, SEED, VIEWS = Quality(points=2, samples=16), 0, 2  # of the pictures that are looked at; scores have the protocol's
KILLED = "killed and resumed"
TOLERANCE = 1e-3  # beyond [0, 1]: interpolation and antialiasing
COMPONENTS = {"albedo": ("albedo", "aligned_albedo"), "roughness": ("roughness",)}  # of scores, where they have other names

Fit = Callable[[Scene, "Memory"], Reconstruction]


class Killed(KeyboardInterrupt):
    """The end of the process in the middle of a fit."""


class Memory:
    """What outlives a process: the monitor's side of checkpoints, held as the bytes that a file would hold.

    ``deadly``: the process is told to stop when it asks for the second time, and ends with its next checkpoint.
    """

    def __init__(self, *, deadly: bool = False) -> None:
        self.state: bytes | None = None
        self.deadly = deadly

    def monitor(self) -> Monitor:
        """What a process is given that starts with this memory."""
        asked = itertools.count(1)
        return Monitor.silent(save=self._save, load=self._load, stopping=lambda: next(asked) > 1 and self.deadly)

    def _save(self, state: dict[str, Any]) -> None:
        buffer = io.BytesIO()
        torch.save(state, buffer)
        self.state = buffer.getvalue()
        if self.deadly:
            raise Killed

    def _load(self) -> dict[str, Any] | None:
        """What is no tensor, number, text, list or dict of them is refused, as by a run."""
        return None if self.state is None else torch.load(io.BytesIO(self.state), weights_only=True)


def check_method(make: Callable[[], Any], make_problem: Callable[[Scene], Problem], scene: Scene) -> Iterator[Finding]:
    """Check the method that ``make()`` returns; an instance for every fit. Never raises for what the method does.

    ``make_problem``: makes a problem of a scene that has its truth, as ``scene`` has, just as a run does.
    """
    what, expected = "Options, presets and info", "as the contract describes them"
    try:
        method = make()
        check_declarations(type(method).__qualname__, method)
    except (Exception, SystemExit) as error:
        yield Finding("fail", what, expected, told(error))
        return
    presets = ", ".join(method.presets) or "none"
    yield Finding("pass", what, expected, f"presets {presets}; predicts {', '.join(sorted(method.info.predicts))}")
    problem, started = make_problem(scene), time.perf_counter()
    before, name, number = deepcopy(problem.scene), type(method).__qualname__, itertools.count()

    def fit(scene: Scene, memory: Memory) -> Reconstruction:
        with other_chance(next(number)):
            return reconstruct(name, make(), make_problem(scene), seed=SEED, monitor=memory.monitor()).reconstruction

    try:
        with other_chance(next(number)):
            result = reconstruct(name, method, problem, seed=SEED, monitor=Memory().monitor())
    except (Exception, SystemExit) as error:
        yield Finding("fail", "a fit", "a result as the contract describes it", told(error))
        yield Finding("skip", "everything else", "", "it needs a sound result")
        return
    found, seconds = result.reconstruction, time.perf_counter() - started
    yield Finding("pass", "a fit", "", f"{seconds:.1f} s, of {result.steps} steps")
    same = difference(problem.scene, before) is None
    yield judge(same, "the scene", "nothing modified", "" if same else "images, masks, cameras or mesh modified")
    cameras = [view.camera for view in (scene.test or scene.novel or scene.train)[:VIEWS]]
    yield from guarded("what it predicts", "no exception", lambda: _predicted(method.info, found, cameras))
    yield from guarded("the same seed again", "no exception", lambda: _repeated(fit, problem, scene, found, cameras))
    yield from guarded(KILLED, "no exception", lambda: _resumed(fit, scene, found, cameras))
    yield from guarded("scores", "no exception", lambda: _scored(method.info, found, scene))


def with_other_truth(scene: Scene) -> Scene:
    """The same training images, masks, cameras and mesh, and another truth wherever there is one."""

    def changed(view: View) -> View:
        values: dict[str, Any] = {name: 0.5 * value for name in TRUTH_OF_VIEWS if (value := getattr(view, name)) is not None}
        return replace(view, **values)

    def held_out(views: tuple[View, ...]) -> tuple[View, ...]:
        return tuple(replace(changed(view), image=0.5 * view.image) for view in views)

    truth = scene.truth
    if truth is not None:
        known = {name: getattr(truth, name) for name in ("albedo", "roughness", "metallic")}
        textures = {name: 1 - texture for name, texture in known.items() if texture is not None}
        mesh = truth.mesh and replace(truth.mesh, vertices=0.5 * truth.mesh.vertices, normals=-truth.mesh.normals)
        lights = {name: 2 * light for name, light in truth.lights.items()}
        truth = replace(truth, lights=lights, mesh=mesh, **textures)
    train = tuple(map(changed, scene.train))
    return replace(scene, train=train, truth=truth, test=held_out(scene.test), novel=held_out(scene.novel))


# ---- what was recovered ----------------------------------------------------------------------------------------------


def _predicted(info: MethodInfo, found: Reconstruction, cameras: list[Camera]) -> Iterator[Finding]:
    maps = found.maps(cameras, ("albedo", "roughness"), points=QUALITY.points)
    for name in sorted({"albedo", "roughness"} & info.predicts):
        yield _sound(f"map of {name}", maps.get(name), 1 + TOLERANCE)
    if "view_synthesis" in info.predicts:
        yield _sound("render under its own light", found.render(cameras, light=None, albedo_scale=None, quality=QUALITY), math.inf)
    if "relighting" in info.predicts:
        sky = LatLongEnvironment(torch.linspace(1, 0.2, 8)[:, None, None].expand(8, 16, 3).contiguous())
        relit = found.render(cameras, light=sky, albedo_scale=torch.tensor([0.9, 1.0, 1.1]), quality=QUALITY)
        if relit is None and found.assets() is not None:
            yield Finding("pass", "render under another light", "", "none: the reference renderer draws its textures")
        else:
            yield _sound("render under another light", relit, math.inf)
    if found.environment is not None:
        directions = torch.nn.functional.normalize(torch.randn(5, 3, generator=torch.Generator().manual_seed(0)), dim=1)
        answers = (found.environment.radiance(directions), found.environment.latlong(8))
        sound = all(bool(torch.isfinite(value).all() and (value >= 0).all()) for value in answers)
        shapes = [tuple(value.shape) for value in answers]
        expected = "radiance(directions (N, 3)) -> (N, 3) and latlong(8) -> (8, 16, 3), finite, >= 0"
        said = f"{shapes}, {'sound' if sound else 'unsound'} values"
        yield judge(sound and shapes == [(5, 3), (8, 16, 3)], "environment", expected, said)


def _sound(what: str, images: Images | None, most: float) -> Finding:
    expected = "finite, >= 0" + (" and <= 1" if math.isfinite(most) else "") + ", nothing outside the object"
    if images is None:
        return Finding("fail", what, expected, "none, though info.predicts it")
    values = np.concatenate([image.ravel() for image in images.images])
    bad = int((~np.isfinite(values)).sum())
    fits = not bad and values.min() >= -TOLERANCE and values.max() <= most
    far = [maximum_filter(cover, 3) == 0 for cover in images.coverage]  # a pixel away, for a renderer's own pixel filter
    outside = max(float(np.abs(image[empty]).max(initial=0)) for image, empty in zip(images.images, far, strict=True))
    found = f"{values.min():.3g} ... {values.max():.3g}, {bad} not finite, up to {outside:.2g} outside the object"
    return judge(fits and outside < TOLERANCE, what, expected, found)


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
    largest = float(np.max([np.abs(one - other).max(initial=0) for one, other in pairs], initial=0))  # NaN if there is any
    said = f"pictures that differ by up to {largest:.3g}" if largest else ""
    return judge(largest == 0, what, "the same reconstruction to the bit", said)


def _pictures(found: Reconstruction, cameras: list[Camera]) -> Iterator[np.ndarray]:
    maps = found.maps(cameras, ("albedo", "roughness"), points=QUALITY.points)
    for images in (*maps.values(), found.render(cameras, light=None, albedo_scale=None, quality=QUALITY)):
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
