"""``python -m ia_bench.report.comparison --scene FOLDER --out PNG [NAME=]RUN_FOLDER...``: runs beside each other and the truth.

One sheet of one scene: a photograph; then a column for the truth and for every run, with aligned albedo and roughness of that
view, the object under a light that no run has seen, and the light of the photographs. Below the pictures stand a run's scores,
which are means over all views of the scene.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.renderer import texture_images
from ia_bench.render.stage import Stage
from ia_bench.report.panels import cut_out, exposure, extent, light_exposure, light_map, on_grey, to_image, unmultiplied
from ia_bench.report.recovered import Recovered, read_run
from ia_bench.runs.config import SceneConfig
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene, View

SAMPLES = 128  # per pixel of the relit picture, twice as many as scores have
SIDE = 2  # G-buffer points along a side of a pixel, as in scoring
CELL = 192  # pixels of a picture on the sheet; that of a light is half as high
MARGIN, LINE, LEGEND = 8, 20, 110  # pixels around pictures, of a line of text, and of the words to the left
PHOTOGRAPH, TRUTH = "photograph", "truth"
LINES = (
    ("aligned\nalbedo", "aligned_albedo", "psnr"),
    ("roughness,\nblack is 0", "roughness", "mse"),
    ("relit", "relighting", "psnr"),
)
"""Pictures of the object from above to below, each with the score of a run that stands below it; the light follows."""


def write_comparison(runs: Mapping[str, Path], scene_folder: Path, out: Path) -> None:
    """Write the sheet of ``runs``, run folders by the names of their columns, to the PNG file ``out``.

    Raises InputError for a run without results, of another scene or named as the truth or the photograph, runs that
    read it differently, and for a scene without a test view with true albedo and roughness or without a novel light.
    """
    for name in (PHOTOGRAPH, TRUTH):
        if name in runs:
            raise InputError(f"expected another name than {name}, which is a column's already, for {runs[name]}")
    read = {name: read_run(folder, scene_folder) for name, folder in runs.items()}
    readers = [reader for _, reader in read.values()]
    if not readers or any(reader != readers[0] for reader in readers):
        raise InputError(f"expected at least one run, all with the same reader, found {readers or 'none'}")
    scene = read_scene(SceneConfig(path=str(scene_folder)), readers[0], truth=True)
    shown = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
    lights = {} if scene.truth is None else scene.truth.lights
    novel = [view for view in scene.novel if view.light != "train" and view.light in lights]
    if not shown or not novel or "train" not in lights:
        raise InputError(f"{scene_folder}: expected a test view with true albedo and roughness, its light, and a novel light")
    shown_by = _Columns(scene, shown[len(shown) // 2], novel[len(novel) // 2])
    columns = {PHOTOGRAPH: shown_by.photograph(), TRUTH: shown_by.truth()}
    columns |= {name: shown_by.recovered(run) for name, (run, _) in read.items()}
    scores = [[_score(run, component, metric) for _, component, metric in LINES] for run, _ in read.values()]
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as partial:
        _compose(columns, [[], [], *scores], shown_by.relit.light).save(partial, format="PNG")


class _Columns:
    """The two views of a scene that the sheet shows, traced once."""

    def __init__(self, scene: Scene, view: View, relit: View) -> None:
        assert scene.truth is not None
        self.view, self.relit = view, relit
        self._side = max(extent(view.mask), extent(relit.mask))
        self._true_light = scene.truth.lights["train"]
        self._light_gain = light_exposure(self._true_light)
        self._stage = Stage(scene.mesh, torch.device("cpu"))
        self._gbuffer, self._relit_gbuffer = (self._stage.gbuffer([one.camera], SIDE) for one in (view, relit))
        self._light = SampledLight.of(torch.from_numpy(scene.truth.lights[relit.light]))
        self._gain = exposure(relit.image[None], relit.mask[None])

    def photograph(self) -> list[np.ndarray]:
        """What the view looks like, (H, W, 3) in [0, 1]; the column has no other picture."""
        image, mask = self.view.image, self.view.mask
        exposed = exposure(image[None], mask[None]) * image
        return [self._cut(linear_to_srgb(unmultiplied(exposed, mask)), mask, mask)]

    def truth(self) -> list[np.ndarray]:
        """Pictures (H, W, 3) in [0, 1] in the order of LINES, and the light."""
        view, relit = self.view, self.relit
        assert view.albedo is not None
        assert view.roughness is not None
        return self._pictures(view.albedo, view.roughness[..., None], view.mask, relit.image, relit.mask, self._true_light)

    def recovered(self, run: Recovered) -> list[np.ndarray]:
        """What :meth:`truth` returns, of a run: albedo times its scores' alignment, also before it is relit, light over it."""
        material = Material(run.scale * run.material.albedo, run.material.roughness, run.material.metallic)
        renderer = self._stage.renderer(bounces=run.bounces, coat=run.coat)
        generator = torch.Generator().manual_seed(0)
        relit = renderer.render_images(self._relit_gbuffer, material, self._light, SAMPLES, generator)["radiance"]
        surface, textures = self._stage.surface, (material.albedo, material.roughness)
        albedo, roughness = (texture_images(surface, self._gbuffer, texture)[0].numpy() for texture in textures)
        coverage, relit_coverage = (part.coverage()[0].numpy() for part in (self._gbuffer, self._relit_gbuffer))
        light = (run.light / run.scale).numpy()
        return self._pictures(albedo, roughness, coverage, relit[0].numpy(), relit_coverage, light)

    def _pictures(
        self,
        albedo: np.ndarray,
        roughness: np.ndarray,
        coverage: np.ndarray,
        relit: np.ndarray,
        relit_coverage: np.ndarray,
        light: np.ndarray,
    ) -> list[np.ndarray]:
        view, under = self.view.mask, self.relit.mask
        return [
            self._cut(linear_to_srgb(unmultiplied(albedo, coverage)), coverage, view),
            self._cut(unmultiplied(roughness, coverage), coverage, view),
            self._cut(linear_to_srgb(unmultiplied(self._gain * relit, relit_coverage)), relit_coverage, under),
            light_map(light, self._light_gain),
        ]

    def _cut(self, picture: np.ndarray, coverage: np.ndarray, mask: np.ndarray) -> np.ndarray:
        return cut_out(on_grey(picture, coverage), mask, self._side)


def _score(run: Recovered, component: str, metric: str) -> str:
    value = run.scores[component][metric]
    if value is None:
        return "-"
    return f"{value:.1f} dB" if metric == "psnr" else f"MSE {value:.4f}"


def _compose(columns: Mapping[str, list[np.ndarray]], scores: list[list[str]], relit_under: str) -> Image.Image:
    down = CELL + LINE + MARGIN
    light_top = 2 * LINE + len(LINES) * down
    sheet = Image.new("RGB", (LEGEND + len(columns) * (CELL + MARGIN) + MARGIN, light_top + CELL // 2 + MARGIN), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)
    for line, (words, _, _) in enumerate(LINES):
        under = f"\nunder\n{relit_under}" if words == LINES[-1][0] else ""
        draw.text((MARGIN, 2 * LINE + line * down + CELL // 2), words + under, fill="black", font=font)
    draw.text((MARGIN, light_top + CELL // 4), "light", fill="black", font=font)
    for column, (name, pictures) in enumerate(columns.items()):
        left = LEGEND + column * (CELL + MARGIN)
        draw.text((left, 2), name.replace(" w/o", "\nw/o"), fill="black", font=font)
        for line, picture in enumerate(pictures):
            top = 2 * LINE + line * down
            size = (CELL, CELL if line < len(LINES) else CELL // 2)
            sheet.paste(to_image(picture).resize(size, Image.Resampling.BICUBIC), (left, top))
        for line, score in enumerate(scores[column]):
            draw.text((left, 2 * LINE + line * down + CELL), score, fill="black", font=font)
    return sheet


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    from ia_bench.common.exit_codes import OK, complain

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
