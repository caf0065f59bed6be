"""Does a reader keep the contract of :mod:`ia_bench.readers.contract`, and what of its scene will be scored?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass

import numpy as np

from ia_bench.checks.finding import Finding, judge, raised
from ia_bench.readers.contract import SPLITS, SceneReader, check_scene, unscored
from ia_bench.render.agreement import GOOD, check_agreement

COMPONENTS = ("albedo", "roughness", "view_synthesis", "relighting")


def check_reader(make: Callable[[], SceneReader]) -> Iterator[Finding]:
    """Check the reader that ``make()`` returns, on the scene that it was made for. Never raises for what the reader does."""
    try:
        scene = check_scene(make().read(truth=True), truth=True)
    except (Exception, SystemExit) as error:
        yield Finding("fail", "scene", "a Scene as its description says", raised(error))
        yield Finding("skip", "everything else", "", "it needs a sound scene")
        return
    counts = ", ".join(f"{len(getattr(scene, split))} {split}" for split in SPLITS)
    yield Finding("pass", "scene", "", f"{counts} views, a mesh of {len(scene.mesh.faces)} triangles")
    yield from (Finding("pass", "note of the reader", "", note) for note in scene.notes)
    try:
        without = check_scene(make().read(truth=False), truth=False)
        found = difference(without.blind(), scene.blind())
    except (Exception, SystemExit) as error:
        found = raised(error)
    yield judge(found is None, "without truth", "the same training views and no truth", found or "that")
    try:
        reader = make()
        found = difference(reader.read(truth=True), reader.read(truth=True), "the scene of the same reader")
        found = found or difference(scene, check_scene(reader.read(truth=True), truth=True), "the scene of another reader")
    except (Exception, SystemExit) as error:
        found = raised(error)
    yield judge(found is None, "reading again", "an equal scene", found or "that")
    seen = {view.image.tobytes() for view in scene.train}
    twice = [view.name for view in (*scene.test, *scene.novel) if view.image.tobytes() in seen]
    yield judge(not twice, "held-out views", "no training image among them", ", ".join(twice) or "none")
    said: list[str] = []
    try:
        agrees = check_agreement(scene, said.append) >= GOOD
    except Exception as error:
        agrees, said = False, [raised(error)]
    yield judge(agrees, "mesh, cameras and masks", f"an intersection over union of {GOOD} at least", said[-1])
    lacking = unscored(scene)
    for name in COMPONENTS:
        said_of = f"not scored: {lacking[name]}" if name in lacking else "scored"
        yield Finding("skip" if name in lacking else "pass", name, "", said_of)


def difference(one: object, two: object, where: str = "scene") -> str | None:
    """Where two scenes differ first, None if they are equal."""
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        return None if one.dtype == two.dtype and np.array_equal(one, two) else where
    if type(one) is not type(two):
        return where
    if is_dataclass(one):
        pairs = [(f"{where}.{field.name}", getattr(one, field.name), getattr(two, field.name)) for field in fields(one)]
    elif isinstance(one, dict) and isinstance(two, dict):
        pairs = [(f"{where}[{key!r}]", one.get(key), two.get(key)) for key in {**one, **two}]
    elif isinstance(one, tuple) and isinstance(two, tuple) and len(one) == len(two):
        pairs = [(f"{where}[{i}]", *pair) for i, pair in enumerate(zip(one, two, strict=True))]
    else:
        return None if one == two else where
    return next((found for name, a, b in pairs if (found := difference(a, b, name)) is not None), None)
