"""Runs beside each other and the truth: one sheet of one scene.

A photograph; then a column for the truth and for every run, with aligned albedo and roughness of that
view, the object under a light that no run has seen, and the light of the photographs. Below the pictures stand a run's scores,
which are means over all views of the scene.

What a scene has no truth of is shown of the runs alone. Without a novel light, the photograph's view is rendered under the light
that a run has recovered; without any truth, as of photographs of one's own, there is no column for it.
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
from ia_bench.runs.pictures.drawing import views_of_maps
from ia_bench.runs.pictures.panels import cut_out, displayed, exposure, extent, light_exposure, light_map, plain, to_image
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Scene, Truth, View

QUALITY = Quality(points=2, samples=128)
CELL = 192  # pixels of a picture on the sheet; that of a light is half as high
MARGIN, LINE, LEGEND = 8, 20, 110  # pixels around pictures, of a line of text, and of the words to the left
PHOTOGRAPH, TRUTH = "photograph", "truth"
LIGHT = "light"
RENDERED, ALBEDO, ALIGNED, ROUGHNESS, RELIT = "rendered", "albedo", "aligned\nalbedo", "roughness,\nblack is 0", "relit"
SCORES = {
    RENDERED: "view_synthesis.psnr",
    ALIGNED: "aligned_albedo.psnr",
    ROUGHNESS: "roughness.mse",
    RELIT: "relighting.psnr",
}
"""What a line of pictures is called -> the score of a run that stands below its picture; an albedo without a truth has none."""
LINES = (ALIGNED, ROUGHNESS, RELIT)
"""Pictures of the object from above to below, where all truth is known; the light follows."""


def write_comparison(runs: Mapping[str, Path], scene_folder: Path, out: Path) -> None:
    """Write the sheet of ``runs``, run folders by the names of their columns, to the PNG file ``out``.

    Raises InputError for a run without results, of another scene or named as the truth or the photograph, runs that
    read it differently, and for a scene without a view.
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
    shown_by = _Columns(scene)
    columns = {PHOTOGRAPH: shown_by.photograph()}
    if truth := shown_by.truth():
        columns[TRUTH] = truth
    stages: dict[CaptureSettings, Stage] = {}  # a capture may make the mesh, whose textures fit no other
    for name, run in read.items():
        if run.capture not in stages:
            stages[run.capture] = Stage(run.read_scene(scene_folder).expect_mesh(), torch.device("cpu"))
        columns[name] = shown_by.recovered(run, stages[run.capture])
    scored = [line for line in shown_by.lines if line in SCORES]
    scores = {name: {line: _score_text(run, SCORES[line]) for line in scored} for name, run in read.items()}
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as partial:
        _compose(columns, scores, shown_by.titles).save(partial, format="PNG")


class _Columns:
    """The views of a scene that the sheet shows, traced once: one of its photographs, and one under a novel light if there is any.

    Attributes:
        lines: What is pictured from above to below; the light follows.
        titles: What stands beside these lines.
    """

    def __init__(self, scene: Scene) -> None:
        """Raises InputError for a scene without a view."""
        views, truth = views_of_maps(scene), scene.truth or Truth({})
        if not views:
            raise InputError(f"{scene.source}: expected a view that can be shown, found none")
        self.view = views[len(views) // 2]
        novel = [view for view in scene.novel if view.light != "train" and view.light in truth.lights]
        self.relit = novel[len(novel) // 2] if novel else None
        self._side = max(extent(view.mask) for view in (self.view, self.relit or self.view))
        self._true_light = truth.lights.get("train")
        albedo = ALBEDO if self.view.albedo is None else ALIGNED
        self.lines: list[str] = [*([RENDERED] if self.relit is None else []), albedo, ROUGHNESS]
        self.titles = dict(zip(self.lines, self.lines, strict=True))
        if self.relit is not None:
            self.lines.append(RELIT)
            self.titles[RELIT] = f"{RELIT}\nunder\n{self.relit.light}"
            self._light = LatLongEnvironment(torch.from_numpy(truth.lights[self.relit.light]))

    def photograph(self) -> dict[str, np.ndarray]:
        """What the view looks like, (H, W, 3) in [0, 1], on the first line; the column has no other picture."""
        return {self.lines[0]: self._radiance(self.view, self.view.image, self.view.mask)}

    def truth(self) -> dict[str, np.ndarray]:
        """Pictures (H, W, 3) in [0, 1] by their lines, and the light: as far as they are known."""
        view, pictures = self.view, dict[str, np.ndarray]()
        if view.albedo is not None:
            pictures[ALIGNED] = self._cut(displayed(view.albedo, view.mask))
        if view.roughness is not None:
            pictures[ROUGHNESS] = self._cut(plain(view.roughness, view.mask))
        if self.relit is not None:
            pictures[RELIT] = self._radiance(self.relit, self.relit.image, self.relit.mask)
        return pictures if self._true_light is None else {**pictures, LIGHT: self._light_map(self._true_light)}

    def recovered(self, run: Recovered, stage: Stage) -> dict[str, np.ndarray]:
        """What :meth:`truth` returns, of a run: albedo times its scores' alignment, also before it is relit, light over it.

        Without the light, and what is rendered under it, where the run recovered none of the whole scene. ``stage``: of the mesh
        that the run had.
        """
        found = run.reconstruction(stage)
        maps = found.maps([self.view.camera], ("albedo", "roughness"), points=QUALITY.points)
        (albedo,), (roughness,), (coverage,) = maps["albedo"].images, maps["roughness"].images, maps["albedo"].coverage
        pictures = {
            ALBEDO if ALBEDO in self.lines else ALIGNED: self._cut(displayed(run.scale.numpy() * albedo, coverage)),
            ROUGHNESS: self._cut(plain(roughness, coverage)),
        }
        if self.relit is not None:
            relit = found.render([self.relit.camera], light=self._light, albedo_scale=run.scale, quality=QUALITY)
            assert relit is not None
            pictures[RELIT] = self._radiance(self.relit, relit.images[0], relit.coverage[0])
        if found.environment is None:
            return pictures
        if RENDERED in self.lines:
            rendered = found.render([self.view.camera], light=None, albedo_scale=None, quality=QUALITY)
            assert rendered is not None
            pictures[RENDERED] = self._radiance(self.view, rendered.images[0], rendered.coverage[0])
        return {**pictures, LIGHT: self._light_map((found.environment.texels / run.scale).numpy())}

    def _radiance(self, view: View, image: np.ndarray, coverage: np.ndarray) -> np.ndarray:
        """An ``image`` of a view at the exposure of its photograph."""
        return self._cut(displayed(exposure(view.image[None], view.mask[None]) * image, coverage), view)

    def _cut(self, picture: np.ndarray, view: View | None = None) -> np.ndarray:
        return cut_out(picture, (view or self.view).mask, self._side)

    def _light_map(self, light: np.ndarray) -> np.ndarray:
        """A light at the exposure of the true one, or at its own where that is unknown."""
        return light_map(light, light_exposure(light if self._true_light is None else self._true_light))


def _score_text(run: Recovered, key: str) -> str:
    value = run.score(key)
    if value is None:
        return "-"
    return f"{value:.1f} dB" if key.endswith("psnr") else f"MSE {value:.4f}"


def _compose(
    columns: Mapping[str, Mapping[str, np.ndarray]], scores: Mapping[str, Mapping[str, str]], titles: Mapping[str, str]
) -> Image.Image:
    """The sheet of pictures by column and line, with ``scores`` below them; ``titles``: line -> what stands beside it."""
    tops = {line: 2 * LINE + place * (CELL + LINE + MARGIN) for place, line in enumerate((*titles, LIGHT))}
    sheet = Image.new("RGB", (LEGEND + len(columns) * (CELL + MARGIN) + MARGIN, tops[LIGHT] + CELL // 2 + MARGIN), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)
    for line, words in {**titles, LIGHT: LIGHT}.items():
        draw.text((MARGIN, tops[line] + (CELL // 4 if line == LIGHT else CELL // 2)), words, fill="black", font=font)
    for column, (name, pictures) in enumerate(columns.items()):
        left = LEGEND + column * (CELL + MARGIN)
        draw.text((left, 2), name.replace(" w/o", "\nw/o"), fill="black", font=font)
        for line, picture in pictures.items():
            size = (CELL, CELL // 2 if line == LIGHT else CELL)
            sheet.paste(to_image(picture).resize(size, Image.Resampling.BICUBIC), (left, tops[line]))
        for line, score in scores.get(name, {}).items():
            draw.text((left, tops[line] + CELL), score, fill="black", font=font)
    return sheet
