"""Whether an object leads to the truth of a scene, by any attribute, item, closure or file name; and a scene of another truth."""

from __future__ import annotations

import functools
import types
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ia_bench.readers.contract import TRUTH_OF_VIEWS
from ia_bench.scenes.scene import Mesh, Scene, View

TRUTHS = tuple(TRUTH_OF_VIEWS)
LEAVES = (type, types.ModuleType, bool, int, float, complex, bytes, type(None))


def leaks(handed: object, scene: Scene) -> list[str]:
    """Where in ``handed`` the truth of ``scene`` can be reached, each by the way that leads there."""
    # What the mesh of the capture has kept of the true one is no secret.
    given = set() if scene.mesh is None else set(map(_digest, _shape(scene.mesh)))
    secret = {digest for array in _secrets(scene) if (digest := _digest(array)) is not None} - given
    return [way for way, value in _reachable(handed) if _tells(value, secret)]


def with_other_truth(scene: Scene) -> Scene:
    """The same training images, masks, cameras and mesh, and another truth wherever there is one."""

    def changed(view: View) -> View:
        values: dict[str, Any] = {name: 0.5 * value for name in TRUTHS if (value := getattr(view, name)) is not None}
        return replace(view, **values)

    def held_out(views: tuple[View, ...]) -> tuple[View, ...]:
        return tuple(replace(changed(view), image=0.5 * view.image) for view in views)

    truth = scene.truth
    if truth is not None:
        albedo, roughness = (None if texture is None else 1 - texture for texture in (truth.albedo, truth.roughness))
        mesh = truth.mesh and replace(truth.mesh, vertices=0.5 * truth.mesh.vertices, normals=-truth.mesh.normals)
        lights = {name: 2 * light for name, light in truth.lights.items()}
        truth = replace(truth, lights=lights, albedo=albedo, roughness=roughness, mesh=mesh)
    train = tuple(map(changed, scene.train))
    return replace(scene, train=train, truth=truth, test=held_out(scene.test), novel=held_out(scene.novel))


def _tells(value: object, secret: set[tuple[object, ...]]) -> bool:
    if isinstance(value, Scene):
        return bool(value.truth or value.test or value.novel)
    if isinstance(value, View):
        return any(getattr(value, name) is not None for name in TRUTHS)
    if isinstance(value, Path | str):
        path = Path(value)
        return "\n" not in str(value) and path.is_absolute() and len(str(value)) < 1000 and (path / "scene.json").exists()
    if isinstance(value, torch.Tensor | np.ndarray):
        return _digest(value) in secret
    return False


def _secrets(scene: Scene) -> Iterator[np.ndarray]:
    for view in (*scene.train, *scene.test, *scene.novel):
        yield from (array for name in TRUTHS if (array := getattr(view, name)) is not None)
    yield from (view.image for view in (*scene.test, *scene.novel))
    if scene.truth is not None:
        yield from scene.truth.lights.values()
        yield from (array for array in (scene.truth.albedo, scene.truth.roughness) if array is not None)
        if scene.truth.mesh is not None:
            yield from _shape(scene.truth.mesh)


def _shape(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The arrays that tell the shape; a smoothed mesh has the texture coordinates of the true one."""
    return mesh.vertices, mesh.normals


def _digest(array: np.ndarray | torch.Tensor) -> tuple[object, ...] | None:
    """What tells one array from another; None for one of a single value, which says nothing."""
    values = array.detach().cpu().numpy() if isinstance(array, torch.Tensor) else array
    if values.dtype.kind != "f" or values.size < 2 or values.min() == values.max():
        return None
    return (values.size, hash(values.astype(np.float32).tobytes()))


def _reachable(start: object) -> Iterator[tuple[str, object]]:
    """Every object that can be reached from ``start``, once, and the way to it."""
    seen: set[int] = set()
    kept: list[object] = []  # so that no id is given twice
    waiting: list[tuple[str, object]] = [(type(start).__name__, start)]
    while waiting:
        way, value = waiting.pop()
        if isinstance(value, LEAVES) or id(value) in seen:
            continue
        seen.add(id(value))
        kept.append(value)
        yield way, value
        waiting += [(f"{way}{step}", part) for step, part in _parts(value)]


def _parts(value: Any) -> Iterator[tuple[str, object]]:  # noqa: ANN401 (whatever a method is handed)
    if isinstance(value, Mapping):
        yield from ((f"[{key!r}]", part) for key, part in value.items())
    elif isinstance(value, list | tuple | set | frozenset):
        yield from ((f"[{index}]", part) for index, part in enumerate(value))
    elif isinstance(value, types.FunctionType):
        for name, cell in zip(value.__code__.co_freevars, value.__closure__ or (), strict=True):
            try:
                yield f" -> {name}", cell.cell_contents
            except ValueError:  # an empty cell
                continue
        yield from ((f" -> default {index}", part) for index, part in enumerate(value.__defaults__ or ()))
    elif isinstance(value, types.MethodType):
        yield ".__self__", value.__self__
    elif isinstance(value, functools.partial):
        yield from ((f" -> {index}", part) for index, part in enumerate((value.func, *value.args, *value.keywords.values())))
    elif not isinstance(value, str | Path | torch.Tensor | np.ndarray):
        yield from ((f".{name}", part) for name, part in getattr(value, "__dict__", {}).items())
        slots = getattr(type(value), "__slots__", ())
        yield from ((f".{name}", getattr(value, name)) for name in slots if isinstance(slots, tuple) and hasattr(value, name))
