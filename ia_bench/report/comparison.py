"""``python -m ia_bench.report.comparison --scene FOLDER --out PNG [NAME=]RUN_FOLDER...``: runs beside each other and the truth.

One sheet of one scene: aligned albedo and roughness of a test view, and the object under a light that no run has seen. A
column for the truth and for every run, with each run's scores over all views below its pictures.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ia_bench.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import EmbreeRays
from ia_bench.render.renderer import Light, make_renderer, texture_images
from ia_bench.report.panels import exposure, on_white, to_image, unmultiplied
from ia_bench.report.recovered import Recovered, read_run
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.native import load_scene
from ia_bench.scenes.scene import Scene, View

SAMPLES = 128  # per pixel of the relit picture, as in scoring
SIDE = 2  # G-buffer points along a side of a pixel, as in scoring
CELL = 192  # pixels of a picture on the sheet, at least; smaller images are enlarged by whole factors
MARGIN, LINE, LEGEND = 8, 20, 110  # pixels around pictures, of a line of text, and of the words to the left
TRUTH = "truth"
LINES = (("albedo", "aligned_albedo", "psnr"), ("roughness", "roughness", "mse"), ("relighting", "relighting", "psnr"))


def write_comparison(runs: Mapping[str, Path], scene_folder: Path, out: Path) -> None:
    """Write the sheet of ``runs``, run folders by the names of their columns, to the PNG file ``out``.

    Raises InputError for a run without results, of another scene or named as the truth, runs that unwrapped the mesh
    differently, and for a scene without a test view with true albedo and roughness or without a novel light.
    """
    if TRUTH in runs:
        raise InputError(f"expected another name than {TRUTH}, which is the first column's, for {runs[TRUTH]}")
    read = {name: read_run(folder, scene_folder) for name, folder in runs.items()}
    atlases = {uv for _, uv in read.values()}
    if len(atlases) != 1:
        raise InputError(f"expected at least one run, all with the same geometry.uv, found {sorted(atlases) or 'none'}")
    scene = load_scene(scene_folder, truth=True, uv=atlases.pop())
    shown = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
    novel = [view for view in scene.novel if view.light != "train"]
    if not shown or not novel:
        raise InputError(f"{scene_folder}: expected a test view with true albedo and roughness, and a novel light")
    stage = _Stage(scene, shown[len(shown) // 2], novel[len(novel) // 2])
    columns = {TRUTH: stage.truth()} | {name: stage.recovered(run) for name, (run, _) in read.items()}
    scores = [[_score(run, component, metric) for _, component, metric in LINES] for run, _ in read.values()]
    out.parent.mkdir(parents=True, exist_ok=True)
    _compose(columns, [[""] * len(LINES), *scores], stage.relit.light).save(out, format="PNG")


class _Stage:
    """The two views of a scene that the sheet shows, traced once."""

    def __init__(self, scene: Scene, view: View, relit: View) -> None:
        assert scene.truth is not None
        self.view, self.relit = view, relit
        self._scene = scene
        self._rays, self._surface = EmbreeRays(scene.mesh), SurfaceInterpolator(scene.mesh, torch.device("cpu"))
        self._gbuffer, self._relit_gbuffer = self._trace(view), self._trace(relit)
        self._light = Light.of(torch.from_numpy(scene.truth.lights[relit.light]))
        self._gain = exposure(relit.image[None], relit.mask[None])

    def truth(self) -> list[np.ndarray]:
        """Pictures (H, W, 3) in [0, 1] in the order of LINES."""
        view, relit = self.view, self.relit
        assert view.albedo is not None
        assert view.roughness is not None
        return self._pictures(view.albedo, view.roughness[..., None], view.mask, relit.image, relit.mask)

    def recovered(self, run: Recovered) -> list[np.ndarray]:
        """The same of a run: its albedo aligned as in its scores, before it is relit too."""
        material = Material(run.scale * run.material.albedo, run.material.roughness, run.material.metallic)
        renderer = make_renderer(
            self._scene.mesh, self._surface, self._rays, shadows="traced", bounces=run.bounces, coat=run.coat
        )
        generator = torch.Generator().manual_seed(0)
        relit = renderer.render_images(self._relit_gbuffer, material, self._light, SAMPLES, generator)["radiance"]
        albedo, roughness = (
            texture_images(self._surface, self._gbuffer, texture)[0].numpy() for texture in (material.albedo, material.roughness)
        )
        coverage, relit_coverage = (part.coverage()[0].numpy() for part in (self._gbuffer, self._relit_gbuffer))
        return self._pictures(albedo, roughness, coverage, relit[0].numpy(), relit_coverage)

    def _pictures(
        self, albedo: np.ndarray, roughness: np.ndarray, mask: np.ndarray, relit: np.ndarray, relit_mask: np.ndarray
    ) -> list[np.ndarray]:
        return [
            on_white(linear_to_srgb(unmultiplied(albedo, mask)), mask),
            on_white(unmultiplied(roughness, mask), mask),
            on_white(linear_to_srgb(unmultiplied(self._gain * relit, relit_mask)), relit_mask),
        ]

    def _trace(self, view: View) -> GBuffer:
        return trace_gbuffer([view.camera], self._rays, SIDE, torch.device("cpu"))


def _score(run: Recovered, component: str, metric: str) -> str:
    value = run.scores[component][metric]
    if value is None:
        return "-"
    return f"{value:.1f} dB" if metric == "psnr" else f"MSE {value:.4f}"


def _compose(columns: Mapping[str, list[np.ndarray]], scores: list[list[str]], light: str) -> Image.Image:
    height, width = next(iter(columns.values()))[0].shape[:2]
    factor = max(1, -(-CELL // max(height, width)))
    height, width = factor * height, factor * width
    down = height + LINE + MARGIN
    sheet = Image.new("RGB", (LEGEND + len(columns) * (width + MARGIN) + MARGIN, 2 * LINE + len(LINES) * down), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)
    for line, (name, _, _) in enumerate(LINES):
        words = f"{name}\nunder\n{light}" if name == "relighting" else name
        draw.text((MARGIN, 2 * LINE + line * down + height // 2), words, fill="black", font=font)
    for column, (name, pictures) in enumerate(columns.items()):
        left = LEGEND + column * (width + MARGIN)
        draw.text((left, 2), name.replace(" w/o", "\nw/o"), fill="black", font=font)
        for line, picture in enumerate(pictures):
            top = 2 * LINE + line * down
            sheet.paste(to_image(picture).resize((width, height), Image.Resampling.NEAREST), (left, top))
            draw.text((left, top + height), scores[column][line], fill="black", font=font)
    return sheet


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    from ia_bench.__main__ import OK, complain

    parser = argparse.ArgumentParser(prog="python -m ia_bench.report.comparison", allow_abbrev=False)
    parser.add_argument("runs", nargs="+", help="[NAME=]RUN_FOLDER; without a name the folder's")
    parser.add_argument("--scene", type=Path, required=True, help="folder of their scene")
    parser.add_argument("--out", type=Path, required=True, help="PNG file to write")
    wanted = parser.parse_args(arguments)
    pairs = [text.split("=", 1) if "=" in text else (Path(text).name, text) for text in wanted.runs]
    names = [name for name, _ in pairs]
    try:
        if len(set(names)) < len(names):
            raise InputError(f"expected different names of the runs, found {', '.join(names)}; write NAME=RUN_FOLDER")
        write_comparison({name: Path(folder) for name, folder in pairs}, wanted.scene, wanted.out)
    except InputError as error:
        return complain(str(error))
    print(wanted.out)
    return OK


if __name__ == "__main__":
    sys.exit(main())
