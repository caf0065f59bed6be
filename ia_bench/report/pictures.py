"""What a run recovered, beside the truth: one sheet.

A few test views in rows (photograph and our render of the recovered asset, true and recovered albedo and
roughness), and the true and the recovered light below. No OpenGL: the saved maps go through our own renderer.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.report.panels import displayed, exposure, light_exposure, light_map, plain, to_image
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import View

SAMPLES = 64  # per pixel of the re-render
SIDE = 2  # G-buffer points along a side of a pixel, as in scoring
CELL = 192  # pixels of a picture on the sheet, at least; smaller images are enlarged by whole factors
MARGIN, LINE = 8, 24  # pixels around pictures, and of a line of text
SHOWN = ("aligned_albedo", "view_synthesis", "relighting")  # whose PSNR stands in the title
COLUMNS = ("photograph", "our render", "true albedo", "recovered albedo", "true roughness", "recovered roughness")


def write_contact_sheet(run_folder: Path, scene_folder: Path, out: Path, *, views: int = 3) -> None:
    """Write the sheet of ``views`` test views, evenly chosen, to the PNG file ``out``.

    Recovered albedo is multiplied by the scale that aligned it in metrics.json, the recovered light divided by it. One
    exposure serves all photographs and renders, another both lights. Raises InputError for a run without results or of
    another scene, and for a scene without test views and their true albedo and roughness.
    """
    if views < 1:
        raise InputError(f"expected at least one view, found {views}")
    run = Recovered(run_folder)
    scene = run.read_scene(scene_folder)
    usable = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
    if not usable or scene.truth is None or "train" not in scene.truth.lights:
        raise InputError(f"{scene_folder}: expected test views with true albedo and roughness, and the training light")
    chosen = [usable[i] for i in np.linspace(0, len(usable) - 1, min(views, len(usable))).round().astype(int)]
    found = run.reconstruction(Stage(scene.mesh, torch.device("cpu")))
    rows = _rows(chosen, found, run.scale)
    true = scene.truth.lights["train"]
    assert found.environment is not None
    lights = [light_map(light, light_exposure(true)) for light in (true, (found.environment.texels / run.scale).numpy())]
    words = [f"{row} {run.metrics.get(row, str | int)}" for row in ("scene", "seed")]
    values = {name: run.score(f"{name}.psnr") for name in SHOWN}
    shown = [f"{name.replace('_', ' ')} {value:.1f} dB" for name, value in values.items() if value is not None]
    sheet = _compose(rows, lights, ", ".join([run.metrics.get("row", str), *words, *shown]))
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as partial:
        sheet.save(partial, format="PNG")


def _rows(views: Sequence[View], found: TexturedReconstruction, scale: torch.Tensor) -> list[list[np.ndarray]]:
    """Pictures (H, W, 3) in [0, 1], one list per view in the order of COLUMNS."""
    cameras = [view.camera for view in views]
    maps = found.maps(cameras, ("albedo", "roughness"), points=SIDE)
    rendered = found.render(cameras, light=None, albedo_scale=None, points=SIDE, samples=SAMPLES, seed=0)
    assert rendered is not None
    gain = exposure(np.stack([view.image for view in views]), np.stack([view.mask for view in views]))
    rows = []
    for i, view in enumerate(views):
        assert view.albedo is not None
        assert view.roughness is not None
        albedo, roughness, coverage = maps["albedo"].images[i], maps["roughness"].images[i], rendered.coverage[i]
        lit = [displayed(gain * image, cover) for image, cover in ((view.image, view.mask), (rendered.images[i], coverage))]
        painted = [displayed(view.albedo, view.mask), displayed(scale.numpy() * albedo, coverage)]
        rows.append([*lit, *painted, plain(view.roughness, view.mask), plain(roughness, coverage)])
    return rows


def _compose(rows: list[list[np.ndarray]], lights: list[np.ndarray], title: str) -> Image.Image:
    height, width = rows[0][0].shape[:2]
    factor = max(1, -(-CELL // max(height, width)))
    height, width = factor * height, factor * width
    across = len(COLUMNS) * (width + MARGIN) + MARGIN
    light_width = (across - 3 * MARGIN) // 2
    light_height = light_width // 2
    down = 2 * LINE + len(rows) * (height + MARGIN) + LINE + light_height + MARGIN
    sheet = Image.new("RGB", (across, down), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=15)
    draw.text((MARGIN, 4), title, fill="black", font=font)
    for column, name in enumerate(COLUMNS):
        left = MARGIN + column * (width + MARGIN)
        draw.text((left, LINE + 3), name, fill="black", font=font)
        for row, pictures in enumerate(rows):
            picture = to_image(pictures[column]).resize((width, height), Image.Resampling.NEAREST)
            sheet.paste(picture, (left, 2 * LINE + row * (height + MARGIN)))
    top = 2 * LINE + len(rows) * (height + MARGIN)
    for column, (name, light) in enumerate(zip(("true light", "recovered light"), lights, strict=True)):
        left = MARGIN + column * (light_width + MARGIN)
        draw.text((left, top + 3), name, fill="black", font=font)
        kind = Image.Resampling.NEAREST if light.shape[1] < light_width else Image.Resampling.BOX
        sheet.paste(to_image(light).resize((light_width, light_height), kind), (left, top + LINE))
    return sheet
