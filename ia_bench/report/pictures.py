"""``python -m ia_bench.report.pictures RUN_FOLDER --scene FOLDER --out PNG``: what a run recovered, beside the truth.

One sheet: a few test views in rows (photograph and our render of the recovered asset, true and recovered albedo and
roughness), and the true and the recovered light below. No OpenGL: the saved maps go through our own renderer.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.light.latlong import SampledLight
from ia_bench.render.renderer import texture_images
from ia_bench.render.stage import Stage
from ia_bench.report.panels import exposure, light_exposure, light_map, on_grey, to_image, unmultiplied
from ia_bench.report.recovered import Recovered, read_run
from ia_bench.runs.config import SceneConfig
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene, View

SAMPLES = 64  # per pixel of the re-render
SIDE = 2  # G-buffer points along a side of a pixel, as in scoring
CELL = 192  # pixels of a picture on the sheet, at least; smaller images are enlarged by whole factors
MARGIN, LINE = 8, 24  # pixels around pictures, and of a line of text
COLUMNS = ("photograph", "our render", "true albedo", "recovered albedo", "true roughness", "recovered roughness")


def write_contact_sheet(run_folder: Path, scene_folder: Path, out: Path, *, views: int = 3) -> None:
    """Write the sheet of ``views`` test views, evenly chosen, to the PNG file ``out``.

    Recovered albedo is multiplied by the scale that aligned it in metrics.json, the recovered light divided by it. One
    exposure serves all photographs and renders, another both lights. Raises InputError for a run without results or of
    another scene, and for a scene without test views and their true albedo and roughness.
    """
    if views < 1:
        raise InputError(f"expected at least one view, found {views}")
    recovered, reader = read_run(run_folder, scene_folder)
    scene = read_scene(SceneConfig(path=str(scene_folder)), reader, truth=True)
    usable = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
    if not usable or scene.truth is None or "train" not in scene.truth.lights:
        raise InputError(f"{scene_folder}: expected test views with true albedo and roughness, and the training light")
    chosen = [usable[i] for i in np.linspace(0, len(usable) - 1, min(views, len(usable))).round().astype(int)]
    rows = _rows(scene, chosen, recovered)
    true = scene.truth.lights["train"]
    gain = light_exposure(true)
    lights = [light_map(light, gain) for light in (true, (recovered.light / recovered.scale).numpy())]
    sheet = _compose(rows, lights, recovered.title)
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as partial:
        sheet.save(partial, format="PNG")


def _rows(scene: Scene, views: Sequence[View], recovered: Recovered) -> list[list[np.ndarray]]:
    """Pictures (H, W, 3) in [0, 1], one list per view in the order of COLUMNS."""
    stage = Stage(scene.mesh, torch.device("cpu"))
    gbuffer = stage.gbuffer([view.camera for view in views], SIDE)
    renderer = stage.renderer(bounces=recovered.bounces, coat=recovered.coat)
    generator = torch.Generator().manual_seed(0)
    images = renderer.render_images(gbuffer, recovered.material, SampledLight.of(recovered.light), SAMPLES, generator)
    rendered = images["radiance"].numpy()
    coverage = gbuffer.coverage().numpy()
    albedo = texture_images(stage.surface, gbuffer, recovered.scale * recovered.material.albedo).numpy()
    roughness = texture_images(stage.surface, gbuffer, recovered.material.roughness).numpy()
    gain = exposure(np.stack([view.image for view in views]), np.stack([view.mask for view in views]))
    rows = []
    for i, view in enumerate(views):
        assert view.albedo is not None
        assert view.roughness is not None
        rows.append(
            [
                on_grey(linear_to_srgb(unmultiplied(gain * view.image, view.mask)), view.mask),
                on_grey(linear_to_srgb(unmultiplied(gain * rendered[i], coverage[i])), coverage[i]),
                on_grey(linear_to_srgb(unmultiplied(view.albedo, view.mask)), view.mask),
                on_grey(linear_to_srgb(unmultiplied(albedo[i], coverage[i])), coverage[i]),
                on_grey(unmultiplied(view.roughness[..., None], view.mask), view.mask),
                on_grey(unmultiplied(roughness[i], coverage[i]), coverage[i]),
            ]
        )
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    from ia_bench.common.exit_codes import OK, complain

    parser = argparse.ArgumentParser(prog="python -m ia_bench.report.pictures", allow_abbrev=False)
    parser.add_argument("run_folder", type=Path, help="folder of a finished run")
    parser.add_argument("--scene", type=Path, required=True, help="folder of its scene")
    parser.add_argument("--out", type=Path, required=True, help="PNG file to write")
    parser.add_argument("--views", type=int, default=3, help="test views, evenly chosen (default 3)")
    wanted = parser.parse_args(arguments)
    try:
        write_contact_sheet(wanted.run_folder, wanted.scene, wanted.out, views=wanted.views)
    except InputError as error:
        return complain(str(error))
    print(wanted.out)
    return OK


if __name__ == "__main__":
    sys.exit(main())
