"""The one place where methods, couplings and regularisers are called: what they give back is checked before anybody uses it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.declared import Declared
from ia_bench.common.errors import PluginError
from ia_bench.common.registry import BUILT_IN, Kind, at_work
from ia_bench.common.settings import check_fields
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Coupling, Method, Monitor, Problem, Regulariser, Result
from ia_bench.methods.monitor import NOT_OF_THE_ROW, OF_THE_FIT
from ia_bench.priors.validation import MOST, check_numbers
from ia_bench.readers.contract import ROUNDING
from ia_bench.render.reconstruction import Assets, Reconstruction, TexturedReconstruction
from ia_bench.scenes.exr import BRIGHTEST
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Mesh

LARGEST_SIDE = 8192
"""Texels along a side of a texture or a light, as of any image: the albedo has .8 GB then, and every copy of it as many."""


def reconstruct(name: str, method: Method, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
    """What ``method``, called ``name``, makes of a problem, checked. Raises PluginError, naming it, for anything else."""

    def score(phase: str, step: int, seconds: float, recovered: Callable[[], Reconstruction]) -> None:
        monitor.score(phase, step, seconds, lambda: checked_reconstruction(name, recovered()))

    with nullcontext() if _built_in(method) else at_work("method", name):  # our own mistakes keep their traceback
        result = method.fit(problem, seed=seed, monitor=replace(monitor, score=score))
    return checked_result(name, result)


def checked_result(name: str, result: Any) -> Result:  # noqa: ANN401 (whatever the method returned)
    """``result`` with numbers of Python's own, if it is what the contract says."""
    who = f"method {name}: fit()"
    _expect(isinstance(result, Result), who, "ia_bench.methods.contract.Result", result)
    seconds = {what: float(value) for what, value in _numbers(f"{who}: seconds", result.seconds, Real)}
    counters = {what: int(value) for what, value in _numbers(f"{who}: counters", result.counters, Integral)}
    ((_, steps),) = _numbers(who, {"steps": result.steps}, Integral)
    if twice := seconds.keys() & {*OF_THE_FIT, *NOT_OF_THE_ROW}:
        raise PluginError(f"{who}: seconds: expected phases of the method's own, found {min(twice)}, which the run books itself")
    if not isinstance(result.declared, Declared | None):
        raise PluginError(f"{who}: declared: expected a {Declared.__module__}.Declared or None, found {result.declared!r:.100}")
    if result.declared is not None:
        check_fields(result.declared, f"{who}: declared: ")
    return Result(checked_reconstruction(name, result.reconstruction), seconds, counters, int(steps), result.declared)


def checked_reconstruction(name: str, found: Any) -> Reconstruction:  # noqa: ANN401 (whatever the method returned)
    """``found``, if it is a reconstruction: sound textures, or something whose every answer is checked as it is given."""
    who = f"method {name}: reconstruction"
    with nullcontext() if _built_in(found) else at_work("method", name):
        sound = isinstance(found, Reconstruction) and isinstance(found.renderer, str) and bool(found.renderer)
    _expect(sound, who, "maps, render, assets, environment and the name of a renderer", found)
    if isinstance(found, TexturedReconstruction):
        for part, channels in (("albedo", 3), ("roughness", 1), ("metallic", 1)):
            texture = getattr(found.material, part)
            if texture is not None or part != "metallic":
                _values(f"{who}: {part}", texture, f"(T, T, {channels})", found.device.type, 1)
        if type(found) is TexturedReconstruction:
            _environment(who, found.environment)
            return found
    answers: dict[str, Callable[..., Any]] = {"maps": _maps, "render": _render, "assets": _assets, "environment": _environment}
    checked: Any = Checked("method", name, found, answers, part="reconstruction.")
    _ = checked.environment  # checked at once: nobody may ask for it before the end
    return checked


def checked_part(kind: Kind, name: str, found: Any) -> Any:  # noqa: ANN401 (whatever the plugin made)
    """A coupling or a regulariser as it is if it is built in, else one whose every answer is checked; PluginError for none."""
    expected, answers = ANSWERS[kind]
    _expect(isinstance(found, expected), f"{kind} {name}", f"a {expected.__module__}.{expected.__name__}", found)
    if _built_in(found):
        return found
    for attribute, check in answers.items():
        if not callable(getattr(expected, attribute)):  # a value, which is checked at once; an answer is as it is given
            with at_work(kind, name):
                value = getattr(found, attribute)
            check(f"{kind} {name}: {attribute}", value)
    if kind == "coupling" and found.period and not found.views:
        raise PluginError(f"coupling {name}: views: expected 1 or more of one that asks again every {found.period} steps, found 0")
    return Checked(kind, name, found, answers)


class Checked:
    """A plug-in's object: whatever it raises, or answers and may not, is a PluginError that names it."""

    def __init__(self, kind: Kind, name: str, found: object, answers: Mapping[str, Callable[..., Any]], part: str = "") -> None:
        """``answers``: by attribute, what checks its value or answer, from its full name, that, and what it was given."""
        self._kind, self._name, self._found, self._answers, self._part = kind, name, found, answers, part

    def __getattr__(self, attribute: str) -> Any:  # noqa: ANN401 (as the attribute)
        if attribute.startswith("_"):
            raise AttributeError(attribute)
        with at_work(self._kind, self._name):
            value = getattr(self._found, attribute)
        who = f"{self._kind} {self._name}: {self._part}{attribute}"
        if getattr(value, "__func__", None) in TO_BE_DEFINED:
            raise PluginError(f"{who}(): expected a method of its own, found none")
        check = self._answers.get(attribute, lambda who, answer, *_: answer)
        if not callable(value):
            return check(who, value)

        def call(*given: Any, **named: Any) -> Any:  # noqa: ANN401 (as the method)
            with at_work(self._kind, self._name):
                answer = value(*given, **named)
            return check(f"{who}()", answer, *given)

        return call


def _expect(holds: bool, who: str, expected: str, found: object) -> None:
    """Raise PluginError, saying of what type ``found`` is, unless it ``holds``."""
    if not holds:
        raise PluginError(f"{who}: expected {expected}, found {type(found).__name__}")


def _built_in(what: object) -> bool:
    return type(what).__module__.partition(".")[0] == BUILT_IN


# ---- answers -------------------------------------------------------------------------------------------------------


def _maps(who: str, maps: Any, cameras: Sequence[Camera], *_: object) -> dict[str, Images]:  # noqa: ANN401
    _expect(isinstance(maps, Mapping), who, "a mapping", maps)
    channels = {"albedo": (3,)}
    return {what: _images(f"{who}: {what}", images, cameras, channels.get(what, ())) for what, images in maps.items()}


def _render(who: str, images: Any, cameras: Sequence[Camera]) -> Images | None:  # noqa: ANN401
    return None if images is None else _images(who, images, cameras, (3,))


def _images(who: str, images: Any, cameras: Sequence[Camera], channels: tuple[int, ...]) -> Images:  # noqa: ANN401
    """``images``, if there is one of the right shape for every camera; NaN in them makes scores undefined, with a reason."""
    _expect(isinstance(images, Images), who, f"{Images.__module__}.Images", images)
    expected = [(camera.height, camera.width, *channels) for camera in cameras]
    found, types = [image.shape for image in images.images], sorted({str(image.dtype) for image in images.images})
    if found != expected or {image.dtype.kind for image in images.images} - {"f"}:
        raise PluginError(f"{who}: expected images of {expected}, one for every camera, found {found} of {', '.join(types)}")
    return images


def _assets(who: str, assets: Any) -> Assets | None:  # noqa: ANN401
    if assets is None:
        return None
    sound = isinstance(assets, Assets) and isinstance(assets.mesh, Mesh)
    _expect(sound, who, f"{Assets.__module__}.Assets with a mesh, or None", assets)
    for part, shape in {"albedo": "(T, T, 3)", "roughness": "(T, T)", "metallic": "(T, T)", "light": "(H, 2 H, 3)"}.items():
        if getattr(assets, part) is not None or part in ("albedo", "roughness"):
            _values(f"{who}: {part}", getattr(assets, part), shape, most=BRIGHTEST if part == "light" else 1)
    return assets


def _environment(who: str, light: Any) -> Environment | None:  # noqa: ANN401
    _expect(light is None or isinstance(light, Environment), who, "radiance(directions) and latlong(height)", light)
    if isinstance(light, LatLongEnvironment):
        device = light.texels.device.type if isinstance(light.texels, Tensor) else "cpu"
        _values(f"{who}: light", light.texels, "(H, 2 H, 3)", device, BRIGHTEST)
    return light


def _used(who: str, used: Any, provides: frozenset[str]) -> frozenset[str]:  # noqa: ANN401
    if not isinstance(used, frozenset) or not used <= provides:
        expected = f"a frozenset of some of {', '.join(sorted(provides))}" if provides else "an empty frozenset"
        raise PluginError(f"{who}: expected {expected}, found {used!r:.100}")
    return used


def _losses(who: str, losses: Any, *_: object) -> dict[str, Tensor]:  # noqa: ANN401
    _expect(isinstance(losses, Mapping), who, "a mapping of names to losses", losses)
    for what, value in losses.items():
        if not isinstance(what, str) or not isinstance(value, Tensor) or value.shape != () or value.dtype != torch.float32:
            shown = f"a tensor {tuple(value.shape)} of {value.dtype}" if isinstance(value, Tensor) else f"{value!r:.100}"
            raise PluginError(f"{who}: expected names with single float32 values, found {what!r}: {shown}")
    return dict(losses)


def _state(who: str, state: Any) -> dict[str, Tensor]:  # noqa: ANN401
    if not isinstance(state, Mapping) or not all(isinstance(key, str) and isinstance(kept, Tensor) for key, kept in state.items()):
        raise PluginError(f"{who}: expected a mapping of names to tensors, found {state!r:.100}")
    return dict(state)


def _flag(who: str, value: Any, *_: object) -> bool:  # noqa: ANN401
    if not isinstance(value, bool | np.bool_):
        raise PluginError(f"{who}: expected True or False, found {value!r:.100}")
    return bool(value)


def _count(who: str, value: Any) -> int:  # noqa: ANN401
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 0:
        raise PluginError(f"{who}: expected a whole number >= 0, found {value!r:.100}")
    return int(value)


def _moved(who: str, moved: Any, material: Material, *_: object) -> Material:  # noqa: ANN401
    _expect(isinstance(moved, Material), who, f"a {Material.__module__}.Material", moved)
    for part, channels in (("albedo", 3), ("roughness", 1)):
        given, found = getattr(material, part), getattr(moved, part)
        _values(f"{who}: {part}", found, f"(T, T, {channels})", given.device.type)
        if found.shape != given.shape:
            raise PluginError(f"{who}: {part}: expected shape {tuple(given.shape)}, found {tuple(found.shape)}")
    return moved


ANSWERS: dict[Kind, tuple[type, dict[str, Callable[..., Any]]]] = {
    "coupling": (
        Coupling,
        {
            "says_albedo": _flag,
            "sets_albedo": _flag,
            "period": _count,
            "views": _count,
            "uses": _used,
            "loss": _losses,
            "state": _state,
        },
    ),
    "regulariser": (Regulariser, {"completes": _flag, "due": _flag, "apply": _moved}),
}
"""What a plug-in of each kind must be, and what checks its answers."""

TO_BE_DEFINED = Coupling.prepare, Coupling.loss, Regulariser.apply
"""What a subclass of the base classes has to define."""


def _numbers(who: str, values: Any, kind: type) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """The items of a mapping of names to numbers that are >= 0 and finite, and whole where ``kind`` is Integral."""
    _expect(isinstance(values, Mapping), who, "a mapping of names to numbers", values)
    for what, value in values.items():
        number = isinstance(value, kind) and not isinstance(value, bool)
        if not (isinstance(what, str) and what.isprintable() and number and 0 <= value < MOST):  # also not NaN
            expected = "whole numbers >= 0" if kind is Integral else "finite numbers >= 0"
            raise PluginError(f"{who}: expected names with {expected}, found {what!r}: {value!r:.100}")
        yield what, value


def _values(what: str, value: Any, shape: str, device: str = "", most: float | None = None) -> None:  # noqa: ANN401
    """Raise PluginError unless ``value`` is finite, has that ``shape`` of sides and channels, and lies in 0 to ``most``."""
    check_numbers(what, value, device.replace("meta", "cpu"))
    sides, sizes = tuple(value.shape), shape.strip("()").split(", ")
    fits = len(sides) == len(sizes) and [str(size) for size in sides[2:]] == sizes[2:] and min(sides) > 0
    if not fits or sides[1] != sides[0] * (2 if sizes[1].startswith("2") else 1):
        raise PluginError(f"{what}: expected shape {shape}, found {sides}")
    if max(sides[:2]) > LARGEST_SIDE:
        raise PluginError(f"{what}: expected at most {LARGEST_SIDE} texels a side, found {sides}")
    bad = int((~(torch if device else np).isfinite(value)).sum())
    if bad:
        raise PluginError(f"{what}: expected finite values, found NaN or Inf in {bad} of {math.prod(sides)}")
    least, largest = float(value.min()), float(value.max())
    if most is not None and not (least >= -ROUNDING and largest <= most + ROUNDING):
        raise PluginError(f"{what}: expected values from 0 to {most:g}, found {least:.4g} to {largest:.4g}")
