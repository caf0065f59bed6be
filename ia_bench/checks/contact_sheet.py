"""One picture of a scene as a reader found it: its cameras around its mesh, photographs with the mesh's outline, truth, lights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from ia_bench.checks.splits import HELD_OUT, counted, splits
from ia_bench.common.atomic_file import whole_file
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.runs.pictures.panels import displayed, exposure
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene, View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS, PHOTOS = 8, 16
POINTS = 4000  # of the mesh that are drawn
COLOURS = {"train": "tab:blue", "test": "tab:orange", HELD_OUT: "tab:orange", "novel": "tab:green"}
DIRECTIONS = {"above (x right, y up)": (0, 1), "the front (x right, z up)": (0, 2), "the side (y right, z up)": (1, 2)}


def write_sheet(scene: Scene, path: Path) -> None:
    """Draw the scene and write it as a PNG; raises OSError where the file cannot be written."""
    from matplotlib.figure import Figure

    train = _spread(scene.train, PHOTOS)
    held_out = _spread(scene.novel or scene.test, COLUMNS)
    true = [(view.name, view.albedo, view.mask) for view in _spread(scene.test, COLUMNS) if view.albedo is not None]
    lights = [] if scene.truth is None else list(scene.truth.lights.items())[: COLUMNS // 2]
    bright = exposure([view.image for view in train], [view.mask for view in train])
    rays = None if scene.mesh is None else make_rays(scene.mesh, torch.device("cpu"))

    def photo(kind: str, view: View) -> Callable[[Axes], None]:
        return lambda axes: _photo(axes, view, bright, f"{kind} {view.name}", rays)

    rows: list[list[Callable[[Axes], None]]] = [
        [photo("train", view) for view in train[:COLUMNS]],
        [photo("train", view) for view in train[COLUMNS:]],
        [photo("held out", view) for view in held_out],
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
    _title(figure, scene, {"train": len(train), of_held_out: len(held_out)})
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, format="png", dpi=70)


def _title(figure: Figure, scene: Scene, shown: Mapping[str, int]) -> None:
    mesh = "no mesh" if scene.mesh is None else "red: outline of the mesh"
    figure.suptitle(f"{scene.source}: {counted(scene, shown)}; {mesh}")


def _cameras(scene: Scene) -> dict[str, np.ndarray]:
    """Camera-to-world matrices (V, 4, 4) of each split; a camera of several views stands once, in the first split that has it."""
    places: dict[bytes, tuple[str, np.ndarray]] = {}
    for split, views in splits(scene).items():
        for view in views:
            places.setdefault(view.camera.to_world.tobytes(), (split, view.camera.to_world))
    found: dict[str, list[np.ndarray]] = {}
    for split, matrix in places.values():
        found.setdefault(split, []).append(matrix)
    return {split: np.stack(matrices) for split, matrices in found.items()}


def _spread(views: Sequence[View], count: int) -> list[View]:
    """At most ``count`` of the views, evenly."""
    return [views[place] for place in np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).astype(int))]


def _plan(axes: Axes, scene: Scene, name: str, pair: tuple[int, int]) -> None:
    """Mesh and cameras without perspective; each camera with the way that it looks."""
    across, up = pair
    cameras = _cameras(scene)
    places = np.concatenate([matrices[:, :3, 3] for matrices in cameras.values()])
    length = 0.12 * float(np.abs(places - places.mean(0)).max())
    if scene.mesh is not None:
        step = max(1, len(scene.mesh.vertices) // POINTS)
        points = scene.mesh.vertices[::step]
        axes.scatter(points[:, across], points[:, up], s=1, c="0.4", linewidths=0)
    for split, matrices in cameras.items():
        ahead = -matrices[:, :3, 2] * length
        start = matrices[:, :3, 3]
        axes.quiver(
            start[:, across], start[:, up], ahead[:, across], ahead[:, up],
            color=COLOURS[split], angles="xy", scale_units="xy", scale=1, width=0.004, label=split,
        )  # fmt: skip
    middle, reach = places.mean(0), 1.3 * float(np.abs(places - places.mean(0)).max())
    axes.set_xlim(middle[across] - reach, middle[across] + reach)
    axes.set_ylim(middle[up] - reach, middle[up] + reach)
    axes.set_aspect("equal")
    axes.set_title(f"cameras from {name}")
    axes.legend(loc="upper right")


def _picture(axes: Axes, image: np.ndarray, mask: np.ndarray, title: str) -> None:
    axes.imshow(displayed(image, mask), interpolation="nearest")
    axes.set_title(title if len(title) < 28 else f"...{title[-25:]}", fontsize=8)
    axes.set_axis_off()


def _photo(axes: Axes, view: View, bright: float, title: str, rays: RayCaster | None) -> None:
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
