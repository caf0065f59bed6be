"""Does a reader keep the contract of :mod:`ia_bench.readers.contract`, and what of its scene will be scored?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from ia_bench.checks.contact_sheet import write_sheet
from ia_bench.checks.finding import Finding, judge
from ia_bench.checks.splits import counted
from ia_bench.checks.views import check_views
from ia_bench.common.errors import raised
from ia_bench.readers.contract import TRUTH_OF_VIEWS, SceneReader, check_scene, unscored
from ia_bench.render.agreement import GOOD, check_agreement
from ia_bench.scenes.scene import Scene

AGREEMENT = "mesh, cameras and masks"
COMPONENTS = ("albedo", "roughness", "view_synthesis", "relighting")


def check_reader(make: Callable[[], SceneReader], sheet: Path | None = None) -> Iterator[Finding]:
    """Check the reader that ``make()`` returns, on the scene that it was made for. Never raises for what the reader does.

    ``sheet``: where a picture of the scene is written (:mod:`ia_bench.checks.contact_sheet`).
    """
    try:
        scene = check_scene(make().read(truth=True), truth=True)
    except (Exception, SystemExit) as error:
        yield Finding("fail", "scene", "a Scene as its description says", raised(error))
        yield Finding("skip", "everything else", "", "it needs a sound scene")
        return
    mesh = "no mesh" if scene.mesh is None else f"a mesh of {len(scene.mesh.faces)} triangles"
    yield Finding("pass", "scene", "", f"{counted(scene)}, {mesh}")
    yield from _contents(scene)
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
    yield from _agreement(scene)
    yield from check_views(scene.train, meshless=scene.mesh is None)
    if sheet is not None:
        yield _drawn(scene, sheet)
    lacking = unscored(scene)
    for name in COMPONENTS:
        said_of = f"not scored: {lacking[name]}" if name in lacking else "scored"
        yield Finding("skip" if name in lacking else "pass", name, "", said_of)


def _contents(scene: Scene) -> Iterator[Finding]:
    """What there is in photographs, truth and lights, and what is not there."""
    sizes = Counter(f"{view.camera.width} x {view.camera.height}" for view in scene.train)
    share = float(np.mean([(view.mask > 0.5).mean() for view in scene.train]))
    clipped = float(np.mean([0.0 if view.valid is None else (~view.valid & (view.mask > 0)).mean() for view in scene.train]))
    largest = max(float(view.image.max()) for view in scene.train)
    said = ", ".join(f"{count} of {size} pixels" for size, count in sizes.items())
    found = f"{said}; the object fills {share:.0%} of them, {clipped / share:.1%} of it is saturated; radiance up to {largest:.3g}"
    yield Finding("pass", "photographs", "", found)
    known = {name: sum(getattr(view, name) is not None for view in scene.test) for name in TRUTH_OF_VIEWS}
    there = ", ".join(f"{name} of {count}" for name, count in known.items() if count)
    absent = ", ".join(name for name, count in known.items() if not count)
    yield Finding("pass" if there else "skip", "truth of test views", "", f"{there or 'none'}; there is no {absent or 'other'}")
    maps = set() if scene.truth is None else set(scene.truth.lights)
    seen = {view.light for view in scene.novel} | {"train"}
    without = f"; no map of {_few(seen - maps)}" if seen - maps else ""
    yield Finding("pass" if maps else "skip", "lights", "", f"maps of {_few(maps)}{without}" if maps else f"no map of {_few(seen)}")


def _few(names: set[str]) -> str:
    """At most eight of the names, and how many there are."""
    return ", ".join(sorted(names)[:8]) + (f", ... ({len(names)})" if len(names) > 8 else "")


def _agreement(scene: Scene) -> Iterator[Finding]:
    if scene.mesh is None:
        yield Finding("skip", AGREEMENT, "", "it has no mesh")
        return
    said: list[str] = []
    try:
        agrees = check_agreement(scene, said.append) >= GOOD
    except Exception as error:
        agrees, said = False, [raised(error)]
    yield judge(agrees, AGREEMENT, f"an intersection over union of {GOOD} at least", said[-1])


def _drawn(scene: Scene, sheet: Path) -> Finding:
    try:
        write_sheet(scene, sheet)
    except Exception as error:
        return Finding("fail", "contact sheet", "a picture of the scene", raised(error))
    return Finding("pass", "contact sheet", "", str(sheet))


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
