"""Draw what a page shows of one scene: its truth, and what runs recovered of it, always by the reference renderer.

Every picture is cut out around the object, at one exposure per light, which is the truth's. Errors are those that the protocol
measures: encoded values clipped to [0, 1], divided by coverage, inside the true mask.
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
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Scene, View
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


class Easel:
    """One scene, traced once, and the views of it that are drawn."""

    def __init__(self, scene: Scene) -> None:
        """Raises InputError for a scene without truth that could be compared: no light, no test view with its albedo."""
        truth = scene.truth
        if truth is None or "train" not in truth.lights:
            raise InputError(f"{scene.source}: expected the true light of its photographs")
        self.test = [view for view in scene.test if view.albedo is not None and view.roughness is not None]
        self.lights = [
            name for name in dict.fromkeys(view.light for view in scene.novel) if name != "train" and name in truth.lights
        ]
        self.views = [view for view in scene.novel if view.light == "train"][::VIEW_STRIDE]
        self.relit = {name: [view for view in scene.novel if view.light == name][::RELIT_STRIDE] for name in self.lights}
        if not self.test or not self.lights:
            raise InputError(f"{scene.source}: expected test views with true albedo and roughness, and a novel light")
        novel = [view for name in self.lights for view in self.relit[name]]
        self.turned = self.relit[self.lights[0]][len(self.relit[self.lights[0]]) // 2]
        self._side = max(extent(view.mask) for view in (*self.test, *self.views, *novel))
        self.scene, self._truth = scene, truth
        lit = {"train": (*self.views, *self.test), **self.relit}
        self._gains = {
            name: exposure([view.image for view in views], [view.mask for view in views]) for name, views in lit.items() if views
        }
        self.masks = {
            "albedo": self._masks(self.test),
            "roughness": self._masks(self.test),
            "view": self._masks(self.views),
            "relit": self._masks(novel),
        }

    @cached_property
    def stage(self) -> Stage:
        """The scene's mesh, traced once. Raises InputError where there is none."""
        return Stage(self.scene.expect_mesh(), torch.device("cpu"))

    def truth(self, *, turned: bool = True) -> Pictures:
        """The photographs and the truth behind them; the turning light shows the true textures, if that is wanted."""
        pictures = Pictures()
        self._add(pictures, "photograph", self.test, _of(self.test, "image"), self._gains["train"])
        self._add_maps(pictures, _of(self.test, "albedo"), _of(self.test, "roughness"), None)
        self._add(pictures, "view", self.views, _of(self.views, "image"), self._gains["train"])
        for light, views in self.relit.items():
            self._add(pictures, "relit", views, _of(views, "image"), self._gains[light])
        textures = self._truth.albedo, self._truth.roughness
        if turned and textures[0] is not None and textures[1] is not None:
            material = Material(torch.from_numpy(textures[0]).float(), torch.from_numpy(textures[1]).float()[..., None])
            self._add_turns(pictures, TexturedReconstruction(self.stage, material, None), None)
        pictures.sheets["light"] = [light_map(self._truth.lights["train"], light_exposure(self._truth.lights["train"]))]
        return pictures

    def drawn(self, found: TexturedReconstruction, scale: torch.Tensor) -> Predictions:
        """Draw the chosen views of what was recovered; ``scale`` aligns its albedo where it is relit."""
        maps = found.maps([view.camera for view in self.test], ("albedo", "roughness"), points=MAP_POINTS)
        lights = {name: LatLongEnvironment(torch.from_numpy(self._truth.lights[name]).to(found.device)) for name in self.lights}
        relit = {name: self._drawn(found, self.relit[name], light, scale) for name, light in lights.items()}
        views = None if found.environment is None else self._drawn(found, self.views, None, None)
        return Predictions(maps["albedo"], maps["roughness"], views, relit)

    def chosen(self, scored: Predictions) -> Predictions:
        """The chosen views of those that a scorer has drawn. Raises InputError where textures or relit views were not drawn."""
        if scored.albedo is None or scored.roughness is None or scored.relighting is None:
            raise InputError("not every component was drawn")
        relit = {name: _every(scored.relighting[name], RELIT_STRIDE) for name in self.lights}
        views = None if scored.view_synthesis is None else _every(scored.view_synthesis, VIEW_STRIDE)  # no light was recovered
        return Predictions(scored.albedo, scored.roughness, views, relit)

    def recovered(self, found: TexturedReconstruction, scale: torch.Tensor, drawn: Predictions | None = None) -> Pictures:
        """The same of what was recovered: its albedo also aligned by ``scale``, relit with the aligned one.

        ``drawn``: the chosen views, where somebody has drawn them already.
        """
        pictures, drawn = Pictures(), drawn or self.drawn(found, scale)
        assert drawn.albedo is not None
        assert drawn.roughness is not None
        self._add_maps(pictures, drawn.albedo, drawn.roughness, scale.cpu().numpy())
        if drawn.view_synthesis is not None:
            self._add(pictures, "view", self.views, drawn.view_synthesis, self._gains.get("train", 1.0))
        for light, images in (drawn.relighting or {}).items():
            self._add(pictures, "relit", self.relit[light], images, self._gains[light])
        self._add_turns(pictures, found, scale)
        if found.environment is not None:
            true_light = self._truth.lights["train"]
            radiance = found.environment.latlong(true_light.shape[0]).cpu() / scale.cpu()
            pictures.sheets["light"] = [light_map(radiance.numpy(), light_exposure(true_light))]
        return pictures

    def _add_maps(self, pictures: Pictures, albedo: Images, roughness: Images, scale: np.ndarray | None) -> None:
        self._add(pictures, "albedo", self.test, albedo, 1.0)
        if scale is not None:
            aligned = Images(tuple(scale * image for image in albedo.images), albedo.coverage)
            self._add(pictures, "aligned", self.test, aligned, 1.0)
        for view, image, coverage in zip(self.test, roughness.images, roughness.coverage, strict=True):
            self._put(pictures, "roughness", view, unmultiplied(image[..., None], coverage), None, coverage)

    def _add_turns(self, pictures: Pictures, found: TexturedReconstruction, scale: torch.Tensor | None) -> None:
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
