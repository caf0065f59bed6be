"""What methods and priors are given of a scene leads to no truth: everything that can be reached from it is looked at."""

import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ia_bench.scenes.scene import Scene


def reachable(start: object) -> Iterator[object]:
    """Every object that attributes, slots, items, closures, defaults, bound methods and bases of arrays lead to."""
    waiting, seen = [start], set()
    kept: list[object] = []  # so that no id is given twice
    while waiting:
        value = waiting.pop()
        if id(value) in seen or isinstance(value, type | types.ModuleType | str | bytes | int | float | None):
            if isinstance(value, str):
                yield value
            continue
        seen.add(id(value))
        kept.append(value)
        yield value
        waiting += parts(value)


def parts(value: Any) -> list[object]:
    found = list(getattr(value, "__dict__", {}).values())
    found += [getattr(value, name, None) for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    if isinstance(value, dict):
        found += [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set | frozenset):
        found += value
    elif isinstance(value, types.FunctionType):
        found += [cell.cell_contents for cell in value.__closure__ or ()] + list(value.__defaults__ or ())
    elif isinstance(value, types.MethodType):
        found += [value.__self__, value.__func__]
    elif isinstance(value, np.ndarray):
        found.append(value.base)
    return found


def arrays(value: object) -> list[np.ndarray]:
    return [part for part in reachable(value) if isinstance(part, np.ndarray)]


def test_the_walk_finds_what_is_hidden(tiny: Scene, tiny_folder: Path) -> None:
    light = tiny.truth.lights["train"]
    rows = light[:3]

    def closure() -> np.ndarray:
        return rows

    assert any(part is light for part in reachable({"a": [closure]}))
    assert any(np.shares_memory(part, light) for part in arrays(tiny))
    assert str(tiny_folder) in set(part for part in reachable(tiny) if isinstance(part, str))


def test_a_blind_scene_leads_to_no_truth(tiny: Scene, tiny_folder: Path) -> None:
    blind = tiny.blind()
    found = list(reachable(blind))
    assert not [part for part in found if isinstance(part, Path)]
    assert not [part for part in found if isinstance(part, str) and str(tiny_folder) in part]
    assert not [part for part in arrays(blind) for whole in arrays(tiny) if np.shares_memory(part, whole)]
    given = sorted(view.image.shape for view in tiny.train) + sorted(view.mask.shape for view in tiny.train)
    assert len(arrays(blind)) == 4 + len(tiny.train) + len(given)  # the mesh, cameras, images and masks: nothing else


def test_a_blind_scene_knows_what_is_saturated_and_may_lack_a_mesh(tiny: Scene) -> None:
    valid = np.arange(32 * 32).reshape(32, 32) > 99
    blind = replace(tiny, mesh=None, train=tuple(replace(view, valid=valid) for view in tiny.train)).blind()
    assert blind.mesh is None
    np.testing.assert_array_equal(blind.train[0].valid, valid)
    assert not np.shares_memory(blind.train[0].valid, valid)
