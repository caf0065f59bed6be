"""The one place where methods, couplings and regularisers are called: what they give back is checked before anybody uses it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import PluginError
from ia_bench.common.registry import BUILT_IN, at_work
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.methods.contract import (
    Coupling,
    FitState,
    Method,
    Monitor,
    PixelSamples,
    Problem,
    Regulariser,
    Result,
    StepRender,
)
from ia_bench.render.reconstruction import Assets, Quality, Reconstruction, TexturedReconstruction
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Mesh

LARGEST_SIDE = 16384
"""Texels along a side of a texture, or rows of a light: the albedo has 3 GB then, and every copy of it as many."""

MOST = 2**63
"""Counters and seconds are below it."""


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
    with nullcontext() if _built_in(what) else at_work("method", name):
        yield


def _built_in(what: object) -> bool:
    return type(what).__module__.partition(".")[0] == BUILT_IN


def _numbers(who: str, values: Any, kind: type) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """The items of a mapping of names to numbers that are >= 0 and finite, and whole where ``kind`` is Integral."""
    if not isinstance(values, Mapping):
        raise PluginError(f"{who}: expected a mapping of names to numbers, found {type(values).__name__}")
    for what, value in values.items():
        number = isinstance(value, kind) and not isinstance(value, bool)
        if not (isinstance(what, str) and what.isprintable() and number and 0 <= value < MOST):  # also not NaN
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


# ---- couplings and regularisers ------------------------------------------------------------------------------------


def checked_coupling(name: str, coupling: Any) -> Coupling:  # noqa: ANN401 (whatever the plugin made)
    """``coupling`` as it is if it is built in, else one whose every answer is checked. Raises PluginError for none."""
    if not isinstance(coupling, Coupling):
        raise PluginError(f"coupling {name}: expected a {Coupling.__module__}.Coupling, found {type(coupling).__name__}")
    return coupling if _built_in(coupling) else CheckedCoupling(name, coupling)


class CheckedCoupling(Coupling):
    """A coupling of somebody else's. Every method raises PluginError, naming it, for what it raises or may not answer."""

    def __init__(self, name: str, found: Coupling) -> None:
        self._name, self._found = name, found
        self.sets_albedo, self.period, self.views = bool(found.sets_albedo), int(found.period), int(found.views)

    def uses(self, provides: frozenset[str]) -> frozenset[str]:
        """See :meth:`Coupling.uses`."""
        used = self._ask("uses", provides)
        if not isinstance(used, frozenset) or not used <= provides:
            raise PluginError(f"coupling {self._name}: uses(): expected a part of {set(provides)}, found {used!r:.100}")
        return used

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """See :meth:`Coupling.prepare`."""
        self._ask("prepare", samples, problem)

    def loss(self, render: StepRender, pixels: Tensor) -> dict[str, Tensor]:
        """See :meth:`Coupling.loss`."""
        losses = self._ask("loss", render, pixels)
        who = f"coupling {self._name}: loss()"
        if not isinstance(losses, Mapping):
            raise PluginError(f"{who}: expected a mapping of names to losses, found {type(losses).__name__}")
        for what, value in losses.items():
            if not isinstance(what, str) or not isinstance(value, Tensor) or value.shape != () or value.dtype != torch.float32:
                shown = f"a tensor {tuple(value.shape)} of {value.dtype}" if isinstance(value, Tensor) else f"{value!r:.100}"
                raise PluginError(f"{who}: expected names with single float32 values, found {what!r}: {shown}")
        return dict(losses)

    def update(self, texture: Tensor, step: int) -> None:
        """See :meth:`Coupling.update`."""
        self._ask("update", texture, step)

    def state(self) -> dict[str, Tensor]:
        """See :meth:`Coupling.state`."""
        found: dict[str, Tensor] = self._ask("state")
        return found

    def restore(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Coupling.restore`."""
        self._ask("restore", state)

    def _ask(self, method: str, *given: Any) -> Any:  # noqa: ANN401 (as the method)
        with at_work("coupling", self._name):
            return getattr(self._found, method)(*given)


def checked_regulariser(name: str, regulariser: Any) -> Regulariser:  # noqa: ANN401 (whatever the plugin made)
    """``regulariser`` as it is if it is built in, else one whose every answer is checked. Raises PluginError for none."""
    if not isinstance(regulariser, Regulariser):
        found = type(regulariser).__name__
        raise PluginError(f"regulariser {name}: expected a {Regulariser.__module__}.Regulariser, found {found}")
    return regulariser if _built_in(regulariser) else CheckedRegulariser(name, regulariser)


class CheckedRegulariser(Regulariser):
    """A regulariser of somebody else's. Every method raises PluginError, naming it, for what it raises or may not answer."""

    def __init__(self, name: str, found: Regulariser) -> None:
        self._name, self._found, self.completes = name, found, bool(found.completes)

    def prepare(self, problem: Problem) -> None:
        """See :meth:`Regulariser.prepare`."""
        with at_work("regulariser", self._name):
            self._found.prepare(problem)

    def due(self, step: int, steps: int) -> bool:
        """See :meth:`Regulariser.due`."""
        with at_work("regulariser", self._name):
            return bool(self._found.due(step, steps))

    def apply(self, material: Material, state: FitState) -> Material:
        """See :meth:`Regulariser.apply`."""
        with at_work("regulariser", self._name):
            moved = self._found.apply(material, state)
        who = f"regulariser {self._name}: apply()"
        if not isinstance(moved, Material):
            raise PluginError(f"{who}: expected a {Material.__module__}.Material, found {type(moved).__name__}")
        for part, channels in (("albedo", 3), ("roughness", 1)):
            given, found = getattr(material, part), getattr(moved, part)
            _tensor(f"{who}: {part}", found, f"(T, T, {channels})", given.device.type, square=True)
            if found.shape != given.shape:
                raise PluginError(f"{who}: {part}: expected shape {tuple(given.shape)}, found {tuple(found.shape)}")
        return moved
