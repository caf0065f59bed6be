"""Does a reader keep the contract of :mod:`ia_bench.readers.contract`, and what of its scene will be scored?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import binary_erosion

from ia_bench.checks.finding import Finding, difference, guarded, judge, told
from ia_bench.checks.views import check_views
from ia_bench.common.atomic_file import whole_file
from ia_bench.readers.base import spread
from ia_bench.readers.contract import TRUTH_OF_VIEWS, SceneReader, check_scene, unscored
from ia_bench.render.agreement import GOOD, check_agreement
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.rays import make_rays
from ia_bench.runs.pictures.drawing import exposure, on_grey
from ia_bench.runs.pictures.preview import GAP, labelled
from ia_bench.scenes.images import display
from ia_bench.scenes.scene import Scene

AGREEMENT = "mesh, cameras and masks"
SHOWN, ROW = 16, 8  # training photographs on a sheet, and pictures in a row of it
TILE = 150  # pixels that a picture is wide at least, so that its view's name finds room above it
COMPONENTS = ("albedo", "roughness", "view_synthesis", "relighting")


def check_reader(make: Callable[[], SceneReader], sheet: Path | None = None) -> Iterator[Finding]:
    """Check the reader that ``make()`` returns, on the scene that it was made for. Never raises for what the reader does.

    ``sheet``: where :func:`write_sheet` leaves a picture of the scene.
    """

    def read(truth: bool) -> Scene:
        return check_scene(make().read(truth=truth), truth=truth)

    try:
        scene = read(truth=True)
    except (Exception, SystemExit) as error:
        yield Finding("fail", "scene", "a Scene as its description says", told(error))
        yield Finding("skip", "everything else", "", "it needs a sound scene")
        return
    views = ", ".join(f"{len(getattr(scene, split))} {split}" for split in ("train", "test", "novel") if getattr(scene, split))
    mesh = "no mesh" if scene.mesh is None else f"a mesh of {len(scene.mesh.faces)} triangles"
    yield Finding("pass", "scene", "", f"{views} views, {mesh}")
    yield from _contents(scene)
    yield from (Finding("pass", "note of the reader", "", note) for note in scene.notes)
    yield _equal("without truth", "the same training views and no truth", lambda: (read(truth=False).blind(), scene.blind()))

    def twice() -> tuple[Scene, Scene]:
        reader = make()
        return reader.read(truth=True), reader.read(truth=True)

    yield _equal("reading again", "an equal scene", twice, "the scene of the same reader")
    yield _equal("another reader", "an equal scene", lambda: (scene, read(truth=True)))
    seen = {view.image.tobytes() for view in scene.train}
    repeated = [view.name for view in (*scene.test, *scene.novel) if view.image.tobytes() in seen]
    yield judge(not repeated, "held-out views", "no training image among them", ", ".join(repeated))
    yield from guarded(AGREEMENT, "an answer", lambda: _agreement(scene))
    yield from check_views(scene.train, meshless=scene.mesh is None)
    if sheet is not None:
        yield from guarded("contact sheet", "a picture of the scene", lambda: write_sheet(scene, sheet))
    lacking = unscored(scene)
    for name in COMPONENTS:
        said_of = f"not scored: {lacking[name]}" if name in lacking else "scored"
        yield Finding("skip" if name in lacking else "pass", name, "", said_of)


def _equal(what: str, expected: str, scenes: Callable[[], tuple[Scene, Scene]], where: str = "scene") -> Finding:
    try:
        found = difference(*scenes(), where)
    except (Exception, SystemExit) as error:
        found = told(error)
    return judge(found is None, what, expected, found or "")


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
    agrees = check_agreement(scene, said.append) >= GOOD
    yield judge(agrees, AGREEMENT, f"an intersection over union of {GOOD} at least", said[-1])


def write_sheet(scene: Scene, path: Path) -> Iterator[Finding]:
    """Write some photographs, held-out ones last, with the mesh's outline in red: on the object's edge where all is well."""
    held_out = scene.test or scene.novel
    views = [*spread(scene.train, SHOWN), *spread(held_out, ROW)]
    gain = exposure([view.image for view in views], [view.mask for view in views])
    rays = None if scene.mesh is None else make_rays(scene.mesh, torch.device("cpu"))
    cells: list[tuple[str, Image.Image]] = []
    for view in views:
        tile = on_grey(display(view.image, view.mask, gain), view.mask).copy()
        if rays is not None:
            inside = trace_gbuffer([view.camera], rays, 1, torch.device("cpu")).coverage()[0].numpy() > 0.5
            tile[inside & ~binary_erosion(inside)] = 1, 0, 0
        cells.append((view.name, Image.fromarray((255 * tile).round().astype(np.uint8))))
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [cells[first : first + ROW] for first in range(0, len(cells), ROW)]
    with whole_file(path) as partial:
        labelled(rows, width=GAP + len(rows[0]) * (GAP + max(TILE, *(cell.width for _, cell in cells)))).save(partial, format="PNG")
    yield Finding("pass", "contact sheet", "", str(path))
