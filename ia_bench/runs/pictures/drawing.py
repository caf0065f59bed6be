"""Draw what a page shows of one scene: its truth, and what runs recovered of it, always by the reference renderer.

Every picture is cut out around the object, at one exposure per light, which is that of the photographs; a recovered light beside
no true one has an exposure of its own. Errors are those that the protocol measures: encoded values clipped to [0, 1], divided by
coverage, inside the true mask. What a scene has no truth of (photographs of one's own have none at all) is drawn of runs alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch

from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.runs.pictures.panels import cut_out, exposure, extent, light_exposure, light_map, on_grey, unmultiplied
from ia_bench.runs.pictures.views import every_has, fitted_views, views_of_maps
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Scene, Truth, View
from ia_bench.scores.predictions import Predictions

QUALITY = Quality(points=2, samples=64)
MAP_POINTS = 2
TURNS = 16  # pictures of a light that goes round the object once
VIEW_STRIDE, RELIT_STRIDE = 2, 4  # of the novel views, every second is shown under the training light, every fourth under others
VERSION = 3
"""Part of what a drawing is known by; raised when a change of the code changes pictures of unchanged runs."""


@dataclass
class Pictures:
    """What is shown of the truth or of one run.

    Attributes:
        sheets: Name -> pictures (S, S, 3) in [0, 1], encoded for a display, over grey; "light" is (H, 2 H, 3).
        values: Name -> what is compared with the truth, (S, S, C) encoded and clipped, of the same views.
    """

    sheets: dict[str, list[np.ndarray]] = field(default_factory=dict)
    values: dict[str, list[np.ndarray]] = field(default_factory=dict)


class SceneRenderer:
    """One scene, traced once, and the views of it that are drawn.

    Attributes:
        scene: The scene.
        test: The views that maps are drawn in, as :func:`ia_bench.runs.pictures.views.views_of_maps` chooses them.
        views: The views that are rendered under the recovered light: novel ones of the training light, else ``test``.
        lights: Names of the novel lights whose maps are known.
        relit: The views of each of these lights that are drawn.
        fitted: Names of the drawn views that runs have fitted; none unless the scene holds no view out.
        masks: What is compared, by its name in the truth -> (S, S) bool of every view, True where it is scored.
    """

    def __init__(self, scene: Scene, fitted: Sequence[str] = ()) -> None:
        """``fitted``: the training views to draw of a scene that holds none out, in place of those that are chosen here.

        Raises InputError for a scene without any view, or without one of ``fitted``.
        """
        self.scene, self._truth = scene, scene.truth or Truth({})
        self.test = fitted_views(scene, fitted) if fitted else views_of_maps(scene)
        if not self.test:
            raise InputError(f"{scene.source}: expected a view that can be shown, found none")
        self.lights = [
            name for name in dict.fromkeys(view.light for view in scene.novel) if name != "train" and name in self._truth.lights
        ]
        seen = [view for view in scene.novel if view.light == "train"][::VIEW_STRIDE]
        self.fitted = [] if scene.test or seen else [view.name for view in self.test]
        self.views = seen or self.test
        self.relit = {name: [view for view in scene.novel if view.light == name][::RELIT_STRIDE] for name in self.lights}
        novel = [view for name in self.lights for view in self.relit[name]]
        self.turned = self.relit[self.lights[0]][len(self.relit[self.lights[0]]) // 2] if self.lights else None
        self._side = max(extent(view.mask) for view in (*self.test, *self.views, *novel))
        lit = {"train": (*self.views, *self.test), **self.relit}
        self._gains = {
            name: exposure([view.image for view in views], [view.mask for view in views]) for name, views in lit.items() if views
        }
        compared = {"view": self.views, "relit": novel}
        compared |= {name: self.test for name in ("albedo", "roughness") if every_has(self.test, name)}
        self.masks = {name: self._masks(views) for name, views in compared.items() if views}

    @cached_property
    def stage(self) -> Stage:
        """The scene's mesh, traced once. Raises InputError where there is none."""
        return Stage(self.scene.expect_mesh(), torch.device("cpu"))

    def truth(self, *, turned: bool = True) -> Pictures:
        """The photographs and what is known behind them; the turning light shows the true textures, if that is wanted."""
        pictures = Pictures()
        self._add(pictures, "photograph", self.test, _of(self.test, "image"), self._gains["train"])
        maps = {name: _of(self.test, name) if name in self.masks else None for name in ("albedo", "roughness")}
        self._add_maps(pictures, maps["albedo"], maps["roughness"], None)
        self._add(pictures, "view", self.views, _of(self.views, "image"), self._gains["train"])
        for light, views in self.relit.items():
            self._add(pictures, "relit", views, _of(views, "image"), self._gains[light])
        textures = self._truth.albedo, self._truth.roughness
        if turned and self.turned is not None and textures[0] is not None and textures[1] is not None:
            material = Material(torch.from_numpy(textures[0]).float(), torch.from_numpy(textures[1]).float()[..., None])
            self._add_turns(pictures, TexturedReconstruction(self.stage, material, None), None)
        if "train" in self._truth.lights:
            true_light = self._truth.lights["train"]
            pictures.sheets["light"] = [light_map(true_light, light_exposure(true_light))]
        return pictures

    def drawn(self, found: TexturedReconstruction, scale: torch.Tensor, scored: Predictions | None = None) -> Predictions:
        """The chosen views of what was recovered; ``scale`` aligns its albedo where it is relit.

        Views that a scorer has drawn of it already are taken from ``scored``; all others are drawn here.
        """
        scored = scored or Predictions()
        maps = {name: self._scored_map(getattr(scored, name)) for name in ("albedo", "roughness")}
        lacking = [name for name, images in maps.items() if images is None]
        if lacking:
            maps |= found.maps([view.camera for view in self.test], lacking, points=MAP_POINTS)
        views = self._scored_views(scored.view_synthesis)
        if views is None and found.environment is not None:
            views = self._drawn(found, self.views, None, None)
        relit = {name: _every(images, RELIT_STRIDE) for name, images in (scored.relighting or {}).items() if name in self.lights}
        for name in self.lights:
            if name not in relit:
                light = LatLongEnvironment(torch.from_numpy(self._truth.lights[name]).to(found.device))
                relit[name] = self._drawn(found, self.relit[name], light, scale)
        return Predictions(maps["albedo"], maps["roughness"], views, relit)

    def recovered(self, found: TexturedReconstruction, scale: torch.Tensor, scored: Predictions | None = None) -> Pictures:
        """The same of what was recovered: its albedo also aligned by ``scale`` where a true one is known, and relit with that.

        ``scored`` as in :meth:`drawn`.
        """
        pictures, drawn = Pictures(), self.drawn(found, scale, scored)
        self._add_maps(pictures, drawn.albedo, drawn.roughness, scale.cpu().numpy() if "albedo" in self.masks else None)
        if drawn.view_synthesis is not None:
            self._add(pictures, "view", self.views, drawn.view_synthesis, self._gains["train"])
        for light, views in self.relit.items():
            self._add(pictures, "relit", views, (drawn.relighting or {})[light], self._gains[light])
        self._add_turns(pictures, found, scale)
        if found.environment is not None:
            true_light = self._truth.lights.get("train")
            rows = found.environment.texels.shape[0] if true_light is None else true_light.shape[0]
            radiance = (found.environment.latlong(rows).cpu() / scale.cpu()).numpy()
            pictures.sheets["light"] = [light_map(radiance, light_exposure(radiance if true_light is None else true_light))]
        return pictures

    def _scored_map(self, scored: Images | None) -> Images | None:
        """What a scorer has drawn of all held-out views, if these are the chosen ones."""
        return scored if scored is not None and len(scored) == len(self.scene.test) == len(self.test) else None

    def _scored_views(self, scored: Images | None) -> Images | None:
        """The same of the novel views under the training light, of which some are chosen."""
        return None if scored is None else _every(scored, VIEW_STRIDE)

    def _add_maps(self, pictures: Pictures, albedo: Images | None, roughness: Images | None, scale: np.ndarray | None) -> None:
        if albedo is not None:
            self._add(pictures, "albedo", self.test, albedo, 1.0)
        if albedo is not None and scale is not None:
            aligned = Images(tuple(scale * image for image in albedo.images), albedo.coverage)
            self._add(pictures, "aligned", self.test, aligned, 1.0)
        if roughness is not None:
            for view, image, coverage in zip(self.test, roughness.images, roughness.coverage, strict=True):
                self._put(pictures, "roughness", view, unmultiplied(image[..., None], coverage), None, coverage)

    def _add_turns(self, pictures: Pictures, found: TexturedReconstruction, scale: torch.Tensor | None) -> None:
        if self.turned is None:
            return
        view, light = self.turned, self._truth.lights[self.lights[0]]
        for turn in range(TURNS):
            turned = np.roll(light, round(turn * light.shape[1] / TURNS), axis=1)
            drawn = self._drawn(found, [view], LatLongEnvironment(torch.from_numpy(turned).to(found.device)), scale)
            self._add(pictures, "turned", [view], drawn, self._gains[self.lights[0]])

    def _drawn(
        self, found: TexturedReconstruction, views: Sequence[View], light: LatLongEnvironment | None, scale: torch.Tensor | None
    ) -> Images:
        drawn = found.render([view.camera for view in views], light=light, albedo_scale=scale, quality=QUALITY)
        assert drawn is not None
        return drawn

    def _add(self, pictures: Pictures, name: str, views: Sequence[View], images: Images, gain: float) -> None:
        for view, image, coverage in zip(views, images.images, images.coverage, strict=True):
            values = linear_to_srgb(unmultiplied(image, coverage))
            shown = values if gain == 1 else linear_to_srgb(unmultiplied(gain * image, coverage))
            self._put(pictures, name, view, values, shown, coverage)

    def _put(
        self, pictures: Pictures, name: str, view: View, values: np.ndarray, shown: np.ndarray | None, coverage: np.ndarray
    ) -> None:
        """Add one view to a sheet; roughness has no encoding and is ``shown`` as it is."""
        picture = on_grey(values if shown is None else shown, coverage)
        pictures.sheets.setdefault(name, []).append(cut_out(picture, view.mask, self._side))
        pictures.values.setdefault(name, []).append(cut_out(values, view.mask, self._side, beyond=0))

    def _masks(self, views: Sequence[View]) -> list[np.ndarray]:
        return [cut_out(view.mask[..., None] > 0.5, view.mask, self._side, beyond=0)[..., 0] for view in views]


def _every(images: Images, stride: int) -> Images:
    return Images(images.images[::stride], images.coverage[::stride])


def _of(views: Sequence[View], name: str) -> Images:
    return Images(tuple(getattr(view, name) for view in views), tuple(view.mask for view in views))
