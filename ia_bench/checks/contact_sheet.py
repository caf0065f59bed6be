"""One picture of a scene as a reader found it: its cameras around its mesh, photographs with the mesh's outline, truth, lights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from ia_bench.common.atomic_file import whole_file
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.runs.pictures.panels import displayed, exposure
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS, PHOTOS = 8, 16
POINTS = 4000  # of the mesh that are drawn
HELD_OUT = "held-out"  # test views that are the novel ones, too
COLOURS = {"train": "tab:blue", "test": "tab:orange", HELD_OUT: "tab:orange", "novel": "tab:green"}
DIRECTIONS = {"above (x right, y up)": (0, 1), "the front (x right, z up)": (0, 2), "the side (y right, z up)": (1, 2)}


def splits(scene: Scene) -> dict[str, tuple[View, ...]]:
    """The views of each split by its name, without empty ones.

    A capture of one light has no other novel views than its test views: they are one split then, HELD_OUT.
    """

    def identity(view: View) -> tuple[str, bytes, bytes]:
        return view.light, view.camera.to_world.tobytes(), view.image.tobytes()

    same = scene.test and list(map(identity, scene.test)) == list(map(identity, scene.novel))
    held_out = {HELD_OUT: scene.test} if same else {"test": scene.test, "novel": scene.novel}
    return {name: views for name, views in {"train": scene.train, **held_out}.items() if views}


def counted(scene: Scene, shown: Mapping[str, int] | None = None) -> str:
    """How many views of each split there are, such as "17 train, 3 held-out views"; ``shown``: how many of them a picture has."""
    said = []
    for name, views in splits(scene).items():
        part = (shown or {}).get(name, len(views))
        said.append(f"{len(views)} {name}" + (f" ({part} of {len(views)} shown)" if part < len(views) else ""))
    return f"{', '.join(said)} views"


def write_sheet(scene: Scene, path: Path) -> None:
    """Draw the scene and write it as a PNG; raises OSError where the file cannot be written."""
    from matplotlib.figure import Figure

    train, held_out = _spread(scene.train, PHOTOS), _spread(scene.novel or scene.test, COLUMNS)
    true = [(view.name, view.albedo, view.mask) for view in _spread(scene.test, COLUMNS) if view.albedo is not None]
    lights = [] if scene.truth is None else list(scene.truth.lights.items())[: COLUMNS // 2]
    bright = exposure([view.image for view in train], [view.mask for view in train])
    rays = None if scene.mesh is None else make_rays(scene.mesh, torch.device("cpu"))

    def photographs(kind: str, views: Sequence[View]) -> list[Callable[[Axes], None]]:
        return [partial(_photograph, view=view, bright=bright, title=f"{kind} {view.name}", rays=rays) for view in views]

    rows: list[list[Callable[[Axes], None]]] = [
        photographs("train", train[:COLUMNS]),
        photographs("train", train[COLUMNS:]),
        photographs("held out", held_out),
        [partial(_picture, image=albedo, mask=mask, title=f"true albedo {name}") for name, albedo, mask in true],
        [partial(_light, name=name, radiance=radiance) for name, radiance in lights],
    ]
    kept = [row for row in rows if row]
    figure = Figure(figsize=(2 * COLUMNS, 6 + 2.2 * len(kept)), layout="constrained")
    grid = figure.add_gridspec(1 + len(kept), COLUMNS * 3, height_ratios=[3, *(1 for _ in kept)])
    for place, (name, pair) in enumerate(DIRECTIONS.items()):
        _plan(figure.add_subplot(grid[0, place * COLUMNS : (place + 1) * COLUMNS]), scene, name, pair)
    for number, row in enumerate(kept, 1):
        wide = 6 if row is rows[-1] else 3
        for place, draw in enumerate(row):
            draw(figure.add_subplot(grid[number, place * wide : place * wide + wide]))
    of_held_out = next((name for name in (HELD_OUT, "novel", "test") if name in splits(scene)), HELD_OUT)
    mesh = "no mesh" if scene.mesh is None else "red: outline of the mesh"
    figure.suptitle(f"{scene.source}: {counted(scene, {'train': len(train), of_held_out: len(held_out)})}; {mesh}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, format="png", dpi=70)


def _cameras(scene: Scene) -> dict[str, np.ndarray]:
    """Camera-to-world matrices (V, 4, 4) of each split; a camera of several views stands once, in the first split that has it."""
    found: dict[str, dict[bytes, np.ndarray]] = {}
    for split, views in splits(scene).items():
        for view in views:
            key = view.camera.to_world.tobytes()
            if not any(key in known for known in found.values()):
                found.setdefault(split, {})[key] = view.camera.to_world
    return {split: np.stack(list(matrices.values())) for split, matrices in found.items()}


def _spread(views: Sequence[View], count: int) -> list[View]:
    """At most ``count`` of the views, evenly."""
    return [views[place] for place in np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).astype(int))]


def _plan(axes: Axes, scene: Scene, name: str, pair: tuple[int, int]) -> None:
    """Mesh and cameras without perspective; each camera with the way that it looks."""
    across, up = pair
    cameras = _cameras(scene)
    places = np.concatenate([matrices[:, :3, 3] for matrices in cameras.values()])
    middle, reach = places.mean(0), float(np.abs(places - places.mean(0)).max())
    if scene.mesh is not None:
        points = scene.mesh.vertices[:: max(1, len(scene.mesh.vertices) // POINTS)]
        axes.scatter(points[:, across], points[:, up], s=1, c="0.4", linewidths=0)
    for split, matrices in cameras.items():
        start, ahead = matrices[:, :3, 3], -0.12 * reach * matrices[:, :3, 2]
        arrows = start[:, across], start[:, up], ahead[:, across], ahead[:, up]
        axes.quiver(*arrows, color=COLOURS[split], label=split, angles="xy", scale_units="xy", scale=1, width=0.004)
    axes.set_xlim(middle[across] - 1.3 * reach, middle[across] + 1.3 * reach)
    axes.set_ylim(middle[up] - 1.3 * reach, middle[up] + 1.3 * reach)
    axes.set_aspect("equal")
    axes.set_title(f"cameras from {name}")
    axes.legend(loc="upper right")


def _picture(axes: Axes, image: np.ndarray, mask: np.ndarray, title: str) -> None:
    axes.imshow(displayed(image, mask), interpolation="nearest")
    axes.set_title(title if len(title) < 28 else f"...{title[-25:]}", fontsize=8)
    axes.set_axis_off()


def _photograph(axes: Axes, view: View, bright: float, title: str, rays: RayCaster | None) -> None:
    """A photograph, and where the mesh ends as its camera sees it: on the photograph's own edge where all is well."""
    _picture(axes, view.image * bright, view.mask, title)
    if rays is not None:
        coverage = trace_gbuffer([view.camera], rays, 1, torch.device("cpu")).coverage()[0].numpy()
        if coverage.any():
            axes.contour(coverage, levels=[0.5], colors="red", linewidths=0.8)


def _light(axes: Axes, name: str, radiance: np.ndarray) -> None:
    """A light map as it is kept: row 0 is +z, the middle column +x."""
    step = max(1, len(radiance) // 128)
    shown = radiance[::step, ::step]
    axes.imshow(linear_to_srgb((shown / max(float(np.quantile(shown, 0.98)), 1e-12)).clip(0, 1)), interpolation="nearest")
    axes.set_title(f"light {name} ({radiance.shape[0]} rows)", fontsize=8)
    axes.set_axis_off()
