"""Runs beside each other and the truth: one sheet of one scene.

A photograph; then a column for the truth and for every run, with aligned albedo and roughness of that
view, the object under a light that no run has seen, and the light of the photographs. Below the pictures stand a run's scores,
which are means over all views of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.render.reconstruction import Quality
from ia_bench.render.stage import Stage
from ia_bench.runs.pictures.panels import cut_out, displayed, exposure, extent, light_exposure, light_map, plain, to_image
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Scene, View

QUALITY = Quality(points=2, samples=128)
CELL = 192  # pixels of a picture on the sheet; that of a light is half as high
MARGIN, LINE, LEGEND = 8, 20, 110  # pixels around pictures, of a line of text, and of the words to the left
PHOTOGRAPH, TRUTH = "photograph", "truth"
LINES = (
    ("aligned\nalbedo", "aligned_albedo.psnr"),
    ("roughness,\nblack is 0", "roughness.mse"),
    ("relit", "relighting.psnr"),
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
    read = {name: Recovered(folder) for name, folder in runs.items()}
    for run in read.values():
        run.check_scene(scene_folder)
    readers = [run.reader for run in read.values()]
    if not readers or any(reader != readers[0] for reader in readers):
        raise InputError(f"expected at least one run, all with the same reader, found {readers or 'none'}")
    scene = next(iter(read.values())).read_scene(scene_folder, whole=True)
    shown = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
    lights = {} if scene.truth is None else scene.truth.lights
    novel = [view for view in scene.novel if view.light != "train" and view.light in lights]
    if not shown or not novel or "train" not in lights:
        raise InputError(f"{scene_folder}: expected a test view with true albedo and roughness, its light, and a novel light")
    shown_by = _Columns(scene, shown[len(shown) // 2], novel[len(novel) // 2])
    columns = {PHOTOGRAPH: shown_by.photograph(), TRUTH: shown_by.truth()}
    stages: dict[CaptureSettings, Stage] = {}  # a capture may make the mesh, whose textures fit no other
    for name, run in read.items():
        if run.capture not in stages:
            stages[run.capture] = Stage(run.read_scene(scene_folder).expect_mesh(), torch.device("cpu"))
        columns[name] = shown_by.recovered(run, stages[run.capture])
    scores = [[_score_text(run, key) for _, key in LINES] for run in read.values()]
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
        self._light = LatLongEnvironment(torch.from_numpy(scene.truth.lights[relit.light]))
        self._gain = exposure(relit.image[None], relit.mask[None])

    def photograph(self) -> list[np.ndarray]:
        """What the view looks like, (H, W, 3) in [0, 1]; the column has no other picture."""
        image, mask = self.view.image, self.view.mask
        return [self._cut(displayed(exposure(image[None], mask[None]) * image, mask), mask)]

    def truth(self) -> list[np.ndarray]:
        """Pictures (H, W, 3) in [0, 1] in the order of LINES, and the light."""
        view, relit = self.view, self.relit
        maps = {name: Images((getattr(view, name),), (view.mask,)) for name in ("albedo", "roughness")}
        return self._pictures(maps, Images((relit.image,), (relit.mask,)), self._true_light)

    def recovered(self, run: Recovered, stage: Stage) -> list[np.ndarray]:
        """What :meth:`truth` returns, of a run: albedo times its scores' alignment, also before it is relit, light over it.

        Without the light where the run recovered none of the whole scene. ``stage``: of the mesh that the run had.
        """
        found = run.reconstruction(stage)
        maps = found.maps([self.view.camera], ("albedo", "roughness"), points=QUALITY.points)
        albedo = Images(tuple(run.scale.numpy() * image for image in maps["albedo"].images), maps["albedo"].coverage)
        relit = found.render([self.relit.camera], light=self._light, albedo_scale=run.scale, quality=QUALITY)
        assert relit is not None
        light = None if found.environment is None else (found.environment.texels / run.scale).numpy()
        return self._pictures({**maps, "albedo": albedo}, relit, light)

    def _pictures(self, maps: Mapping[str, Images], relit: Images, light: np.ndarray | None) -> list[np.ndarray]:
        coverage = maps["albedo"].coverage[0]
        pictures = [
            self._cut(displayed(maps["albedo"].images[0], coverage), self.view.mask),
            self._cut(plain(maps["roughness"].images[0], coverage), self.view.mask),
            self._cut(displayed(self._gain * relit.images[0], relit.coverage[0]), self.relit.mask),
        ]
        return pictures if light is None else [*pictures, light_map(light, self._light_gain)]

    def _cut(self, picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
        return cut_out(picture, mask, self._side)


def _score_text(run: Recovered, key: str) -> str:
    value = run.score(key)
    if value is None:
        return "-"
    return f"{value:.1f} dB" if key.endswith("psnr") else f"MSE {value:.4f}"


def _compose(columns: Mapping[str, list[np.ndarray]], scores: list[list[str]], relit_under: str) -> Image.Image:
    down = CELL + LINE + MARGIN
    light_top = 2 * LINE + len(LINES) * down
    sheet = Image.new("RGB", (LEGEND + len(columns) * (CELL + MARGIN) + MARGIN, light_top + CELL // 2 + MARGIN), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)
    for line, (words, _) in enumerate(LINES):
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
