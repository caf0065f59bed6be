"""The one place where a method is called: what it gives back is checked before anybody uses it, and told by its name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import isfinite
from numbers import Integral, Real
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import PluginError
from ia_bench.common.registry import BUILT_IN, at_work
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.methods.contract import Method, Monitor, Problem, Result
from ia_bench.render.reconstruction import Assets, Quality, Reconstruction, TexturedReconstruction
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Mesh

LARGEST_SIDE = 16384
"""Texels along a side of a texture, or rows of a light: the albedo has 3 GB then, and every copy of it as many."""


def reconstruct(name: str, method: Method, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
    """What ``method``, called ``name``, makes of a problem, checked. Raises PluginError, naming it, for anything else."""

    def score(phase: str, step: int, seconds: float, recovered: Callable[[], Reconstruction]) -> None:
        monitor.score(phase, step, seconds, lambda: checked_reconstruction(name, recovered()))

    with _at_work(name, method):
        result = method.fit(problem, seed=seed, monitor=replace(monitor, score=score))
    return checked_result(name, result)


def checked_result(name: str, result: Any) -> Result:  # noqa: ANN401 (whatever the method returned)
    """``result`` with numbers of Python's own, if it is what the contract says."""
    who = f"method {name}: fit()"
    if not isinstance(result, Result):
        raise PluginError(f"{who}: expected {Result.__module__}.Result, found {type(result).__name__}")
    seconds = {what: float(value) for what, value in _numbers(f"{who}: seconds", result.seconds, Real)}
    counters = {what: int(value) for what, value in _numbers(f"{who}: counters", result.counters, Integral)}
    ((_, steps),) = _numbers(who, {"steps": result.steps}, Integral)
    return Result(checked_reconstruction(name, result.reconstruction), seconds, counters, int(steps))


def checked_reconstruction(name: str, found: Any) -> Reconstruction:  # noqa: ANN401 (whatever the method returned)
    """``found``, if it is a reconstruction: sound textures, or something whose every answer is checked as it is given."""
    who = f"method {name}: reconstruction"
    with _at_work(name, found):
        sound = isinstance(found, Reconstruction) and isinstance(found.renderer, str) and bool(found.renderer)
    if not sound:
        expected = "maps, render, assets, environment and the name of a renderer"
        raise PluginError(f"{who}: expected {expected}, found {type(found).__name__}")
    if isinstance(found, TexturedReconstruction):
        device = found.device.type
        for part, channels in (("albedo", 3), ("roughness", 1), ("metallic", 1)):
            texture = getattr(found.material, part)
            if texture is not None or part != "metallic":
                _tensor(f"{who}: {part}", texture, f"(T, T, {channels})", device, square=True)
    _environment(who, found.environment)
    return found if type(found) is TexturedReconstruction else CheckedReconstruction(name, found)


class CheckedReconstruction:
    """A reconstruction of a method's own kind, whose answers are checked. Every method raises PluginError for one that is none."""

    def __init__(self, name: str, found: Reconstruction) -> None:
        self._name, self._found = name, found
        self.renderer = found.renderer

    @property
    def environment(self) -> Environment | None:
        """See :attr:`Reconstruction.environment`."""
        with self._at_work():
            light = self._found.environment
        _environment(f"method {self._name}: reconstruction", light)
        return light

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """See :meth:`Reconstruction.maps`."""
        with self._at_work():
            maps = self._found.maps(cameras, names, points=points)
        if not isinstance(maps, Mapping):
            raise PluginError(f"{self._who('maps()')}: expected a mapping, found {type(maps).__name__}")
        channels = {"albedo": (3,)}
        return {what: self._images(f"maps(): {what}", images, cameras, channels.get(what, ())) for what, images in maps.items()}

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """See :meth:`Reconstruction.render`."""
        with self._at_work():
            images = self._found.render(cameras, light=light, albedo_scale=albedo_scale, quality=quality)
        return None if images is None else self._images("render()", images, cameras, (3,))

    def assets(self) -> Assets | None:
        """See :meth:`Reconstruction.assets`."""
        with self._at_work():
            assets = self._found.assets()
        if assets is None:
            return None
        who = self._who("assets()")
        if not isinstance(assets, Assets) or not isinstance(assets.mesh, Mesh):
            raise PluginError(f"{who}: expected {Assets.__module__}.Assets with a mesh, or None, found {type(assets).__name__}")
        shapes = {"albedo": "(T, T, 3)", "roughness": "(T, T)", "metallic": "(T, T)", "light": "(H, W, 3)"}
        for part, shape in shapes.items():
            array = getattr(assets, part)
            if array is not None or part in ("albedo", "roughness"):
                _array(f"{who}: {part}", array, shape, square=part != "light")
        return assets

    def _at_work(self) -> Any:  # noqa: ANN401 (a context manager)
        return _at_work(self._name, self._found)

    def _who(self, call: str) -> str:
        return f"method {self._name}: reconstruction.{call}"

    def _images(self, what: str, images: Any, cameras: Sequence[Camera], channels: tuple[int, ...]) -> Images:  # noqa: ANN401
        """``images``, if there is one of the right shape for every camera; NaN in them makes scores undefined, with a reason."""
        if not isinstance(images, Images):
            raise PluginError(f"{self._who(what)}: expected {Images.__module__}.Images, found {type(images).__name__}")
        expected = [(camera.height, camera.width, *channels) for camera in cameras]
        found = [image.shape for image in images.images]
        kinds = {image.dtype.kind for image in images.images}
        if found != expected or not kinds <= {"f"}:
            types = ", ".join(sorted({str(image.dtype) for image in images.images}))
            raise PluginError(f"{self._who(what)}: expected images of {expected}, one for every camera, found {found} of {types}")
        return images


@contextmanager
def _at_work(name: str, what: object) -> Iterator[None]:
    """As :func:`ia_bench.common.registry.at_work` for what is not built in; our own mistakes keep their traceback."""
    if type(what).__module__.partition(".")[0] == BUILT_IN:
        yield
        return
    with at_work("method", name):
        yield


def _numbers(who: str, values: Any, kind: type) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """The items of a mapping of names to numbers that are >= 0 and finite, and whole where ``kind`` is Integral."""
    if not isinstance(values, Mapping):
        raise PluginError(f"{who}: expected a mapping of names to numbers, found {type(values).__name__}")
    for what, value in values.items():
        number = isinstance(value, kind) and not isinstance(value, bool)
        if not (isinstance(what, str) and number and isfinite(value) and value >= 0):
            expected = "whole numbers >= 0" if kind is Integral else "finite numbers >= 0"
            raise PluginError(f"{who}: expected names with {expected}, found {what!r}: {value!r:.100}")
        yield what, value


def _environment(who: str, light: Any) -> None:  # noqa: ANN401 (whatever the method returned)
    if light is not None and not isinstance(light, Environment):
        raise PluginError(f"{who}: environment: expected radiance(directions) and latlong(height), found {type(light).__name__}")
    if isinstance(light, LatLongEnvironment):
        device = light.texels.device.type if isinstance(light.texels, Tensor) else ""
        _tensor(f"{who}: light", light.texels, "(H, W, 3)", device, square=False)


def _tensor(what: str, value: Any, shape: str, device: str, *, square: bool) -> None:  # noqa: ANN401
    """Raise PluginError unless ``value`` is a float32 tensor without gradient that :func:`_array` would take."""
    if not isinstance(value, Tensor):
        raise PluginError(f"{what}: expected a tensor, found {type(value).__name__}")
    for kind, expected, found in (
        ("device", device if device != "meta" else "cpu", value.device.type),
        ("type", torch.float32, value.dtype),
        ("gradient", False, value.requires_grad),
    ):
        if found != expected:
            raise PluginError(f"{what}: expected {kind} {expected}, found {found}")
    _sized(what, tuple(value.shape), shape, square)
    bad = int((~torch.isfinite(value)).sum())
    if bad:
        raise PluginError(f"{what}: expected finite values, found NaN or Inf in {bad} of {value.numel()}")


def _array(what: str, value: Any, shape: str, *, square: bool) -> None:  # noqa: ANN401
    """Raise PluginError unless ``value`` is a float32 array of that ``shape``, finite and of a size that can be kept."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float32:
        found = f"one of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise PluginError(f"{what}: expected an array of float32, found {found}")
    _sized(what, value.shape, shape, square)
    bad = int((~np.isfinite(value)).sum())
    if bad:
        raise PluginError(f"{what}: expected finite values, found NaN or Inf in {bad} of {value.size}")


def _sized(what: str, found: tuple[int, ...], shape: str, square: bool) -> None:
    """Raise PluginError unless a shape is as ``shape`` says, of which the first two numbers are sides."""
    channels = shape.strip("()").split(", ")[2:]
    fits = len(found) == 2 + len(channels) and [str(size) for size in found[2:]] == channels and min(found) > 0
    if not fits or (square and found[0] != found[1]):
        raise PluginError(f"{what}: expected shape {shape}, found {found}")
    if max(found[:2]) > LARGEST_SIDE:
        raise PluginError(f"{what}: expected at most {LARGEST_SIDE} texels a side, found {found}")
