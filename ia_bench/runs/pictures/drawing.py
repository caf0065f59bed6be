"""Draw what a page shows of one scene: its truth, and what runs recovered of it, always by the reference renderer.

Every picture is cut out around the object, at one exposure per light, which is that of the photographs; a recovered light beside
no true one has an exposure of its own. Errors are those that the protocol measures: encoded values clipped to [0, 1], divided by
coverage, inside the true mask. What a scene has no truth of (photographs of one's own have none at all) is drawn of runs alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch

from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage, camera_key
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.images import Images, display, straight
from ia_bench.scenes.scene import Scene, Truth, View
from ia_bench.scores.comparison import Predictions

QUALITY = Quality(points=2, samples=64)
MAP_POINTS = 2
TURNS = 16  # pictures of a light that goes round the object once
VIEW_STRIDE, RELIT_STRIDE = 2, 4  # of the novel views, every second is shown under the training light, every fourth under others
FITTED = 6  # training views that stand for a scene that holds none out
VERSION = 4
"""Part of what a drawing is known by; raised when a change of the code changes pictures of unchanged runs."""

GREY = 0.5  # behind objects, display-encoded: white paint and sails are seen on it, and black ones
CUT_MARGIN = 2  # pixels around an object that is cut out


def exposure(images: Iterable[np.ndarray], masks: Iterable[np.ndarray]) -> float:
    """The one factor that brings all but the brightest hundredth of the foreground of all images into [0, 1]; 1 without any."""
    found = np.concatenate([np.zeros(0), *(image[mask > 0.5].max(-1) for image, mask in zip(images, masks, strict=True))])
    return 1 / max(float(np.quantile(found, 0.99)), 1e-12) if len(found) else 1.0


def on_grey(picture: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) in [0, 1] over GREY, (H, W, 3)."""
    alpha = coverage[..., None].clip(0, 1)
    return np.broadcast_to(alpha * picture + (1 - alpha) * GREY, (*coverage.shape, 3))


def extent(mask: np.ndarray) -> int:
    """Side in pixels of the smallest square around what ``mask`` (H, W) covers, with a margin; 1 where it covers nothing."""
    lengths = [np.ptp(found) + 1 + 2 * CUT_MARGIN for found in np.nonzero(mask > 0) if len(found)]
    return int(max(lengths, default=1))


def cut_out(picture: np.ndarray, mask: np.ndarray, side: int, beyond: float = GREY) -> np.ndarray:
    """The square (side, side, C) of ``picture`` (H, W, C) around what ``mask`` (H, W) covers; ``beyond`` is past its edges."""
    places = [(found.min() + found.max() + 1 - side) // 2 if len(found) else 0 for found in np.nonzero(mask > 0)]
    past = [(max(0, -place), max(0, place + side - length)) for place, length in zip(places, mask.shape, strict=True)]
    padded = np.pad(picture, (*past, (0, 0)), constant_values=beyond)
    row, column = (place + before for place, (before, _) in zip(places, past, strict=True))
    return padded[row : row + side, column : column + side].copy()  # a part of it would keep all of it in memory


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
        test: The views that maps are drawn in: the held-out ones of which the most is known, ``views`` where nothing is known but
            photographs; without any, FITTED training views.
        views: The views that are rendered under the recovered light: novel ones of the training light, else ``test``.
        relit: Novel light whose map is known -> the views of it that are drawn.
        fitted: Names of the drawn views that runs have fitted; none unless the scene holds no view out.
        masks: What is compared, by its name in the truth -> (S, S) bool of every view, True where it is scored.
    """

    def __init__(self, scene: Scene, fitted: Sequence[str] = ()) -> None:
        """``fitted``: the training views to draw of a scene that holds none out, in place of those that are chosen here.

        Raises InputError for a scene without any view, or without one of ``fitted``.
        """
        self.scene, self._truth = scene, scene.truth or Truth({})
        by_name = {view.name: view for view in scene.train}
        if lacking := [name for name in fitted if name not in by_name]:
            found = f"found none named {', '.join(lacking)}"
            raise InputError(f"{scene.source}: expected the training views that are pictured, {found}")
        by_light: dict[str, list[View]] = {"train": []}
        for view in scene.novel:
            by_light.setdefault(view.light, []).append(view)
        seen = by_light.pop("train")[::VIEW_STRIDE]
        no_truth = all(view.albedo is None and view.roughness is None for view in scene.test)
        self.test = [by_name[name] for name in fitted] or (seen if no_truth and seen else _views_of_maps(scene))
        if not self.test:
            raise InputError(f"{scene.source}: expected a view that can be shown, found none")
        self.fitted = [] if scene.test or seen else [view.name for view in self.test]
        self.views = seen or self.test
        self.relit = {name: views[::RELIT_STRIDE] for name, views in by_light.items() if name in self._truth.lights}
        novel = [view for views in self.relit.values() for view in views]
        self._shown = {"view": self.views, "relit": novel, **dict.fromkeys(("albedo", "aligned", "roughness"), self.test)}
        self._side = max(extent(view.mask) for view in (*self.test, *self.views, *novel))
        lit = {"train": (*self.views, *self.test), **self.relit}
        self._gains = {name: exposure([view.image for view in of], [view.mask for view in of]) for name, of in lit.items()}
        compared = {"view": self.views, "relit": novel}
        compared |= {name: self.test for name in ("albedo", "roughness") if _images(self.test, name) is not None}
        self.masks = {
            name: [cut_out(view.mask[..., None] > 0.5, view.mask, self._side, beyond=0)[..., 0] for view in views]
            for name, views in compared.items()
            if views
        }

    @cached_property
    def stage(self) -> Stage:
        """The scene's mesh, traced once. Raises InputError where there is none."""
        return Stage(self.scene.expect_mesh(), torch.device("cpu"))

    def of_one_view(self) -> dict[str, int]:
        """Sheet -> its picture of one view, the middle one of those that most sheets show; its own middle one without."""
        cameras = {name: [camera_key(view.camera) for view in views] for name, views in self._shown.items()}
        seen, middle = cameras["view"], len(self.views) // 2
        chosen = seen[max(range(len(seen)), key=lambda n: (sum(seen[n] in of for of in cameras.values()), -abs(n - middle)))]
        return {name: of.index(chosen) if chosen in of else len(of) // 2 for name, of in cameras.items()}

    def told_apart(self, places: Mapping[str, int]) -> str:
        """Which views :meth:`of_one_view` shows, in words, where they are several; else empty."""
        shown = {name: self._shown[name][place] for name, place in places.items() if self._shown[name]}
        if len({camera_key(view.camera) for view in shown.values()}) < 2:
            return ""
        said = {"render": shown.get("view"), "under a new light": shown.get("relit"), "maps": shown.get("albedo")}
        return ", ".join(f"{what} of view {view.name}" for what, view in said.items() if view is not None)

    def truth(self, *, turned: bool = True) -> Pictures:
        """The photographs and what is known behind them; the turning light shows the true textures, if that is wanted."""
        relit = {light: images for light, views in self.relit.items() if (images := _images(views, "image"))}
        maps = _images(self.test, "albedo"), _images(self.test, "roughness")
        pictures = self._pictures(Predictions(*maps, _images(self.views, "image"), relit))
        self._add(pictures, "photograph", self.test, _images(self.test, "image"), "train")
        albedo, roughness = self._truth.albedo, self._truth.roughness
        if turned and albedo is not None and roughness is not None:
            material = Material(torch.from_numpy(albedo).float(), torch.from_numpy(roughness).float()[..., None])
            self._add_turns(pictures, TexturedReconstruction(self.stage, material, None), None)
        if "train" in self._truth.lights:
            pictures.sheets["light"] = [_light_map(self._truth.lights["train"], self._truth.lights["train"])]
        return pictures

    def recovered(
        self,
        found: TexturedReconstruction,
        scale: torch.Tensor,
        scored: Predictions | None = None,
        turned: Callable[[], None] = lambda: None,
    ) -> Pictures:
        """The same of what was recovered: its albedo also aligned by ``scale`` where a true one is known, and relit with that.

        Views that a scorer has drawn of it already are taken from ``scored``; all others are drawn here. ``turned`` is told of each
        of the TURNS.
        """
        drawn = self._drawn(found, scale, scored or Predictions())
        pictures = self._pictures(drawn)
        if drawn.albedo is not None and "albedo" in self.masks:
            aligned = tuple(scale.cpu().numpy() * image for image in drawn.albedo.images)
            self._add(pictures, "aligned", self.test, Images(aligned, drawn.albedo.coverage))
        self._add_turns(pictures, found, scale, turned)
        if found.environment is not None:
            true_light = self._truth.lights.get("train")
            rows = found.environment.texels.shape[0] if true_light is None else true_light.shape[0]
            radiance = (found.environment.latlong(rows).cpu() / scale.cpu()).numpy()
            pictures.sheets["light"] = [_light_map(radiance, radiance if true_light is None else true_light)]
        return pictures

    def _drawn(self, found: TexturedReconstruction, scale: torch.Tensor, scored: Predictions) -> Predictions:
        maps: dict[str, Images | None] = {"albedo": scored.albedo, "roughness": scored.roughness}
        same = [camera_key(view.camera) for view in self.test] == [camera_key(view.camera) for view in self.scene.test]
        lacking = [name for name, of in maps.items() if of is None or not same or len(of) != len(self.test)]
        if lacking:
            maps |= found.maps([view.camera for view in self.test], lacking, points=MAP_POINTS)
        views = None
        if scored.view_synthesis is not None:
            views = _every(scored.view_synthesis, VIEW_STRIDE)
        elif found.environment is not None:
            views = self._rendered(found, self.views, None, None)
        scored_light = scored.relighting or {}
        relit = {
            name: _every(scored_light[name], RELIT_STRIDE)
            if name in scored_light
            else self._rendered(found, views, self._truth.lights[name], scale)
            for name, views in self.relit.items()
        }
        return Predictions(maps["albedo"], maps["roughness"], views, relit)

    def _pictures(self, drawn: Predictions) -> Pictures:
        """The sheets of maps and renders."""
        pictures = Pictures()
        self._add(pictures, "albedo", self.test, drawn.albedo)
        self._add(pictures, "roughness", self.test, drawn.roughness)
        self._add(pictures, "view", self.views, drawn.view_synthesis, "train")
        for light, views in self.relit.items():
            self._add(pictures, "relit", views, (drawn.relighting or {})[light], light)
        return pictures

    def _add_turns(
        self,
        pictures: Pictures,
        found: TexturedReconstruction,
        scale: torch.Tensor | None,
        turned: Callable[[], None] = lambda: None,
    ) -> None:
        """Add the middle view of the first novel light, under that light as it goes round the object."""
        for name, views in [*self.relit.items()][:1]:
            light, view = self._truth.lights[name], [views[len(views) // 2]]
            for turn in range(TURNS):
                around = np.roll(light, round(turn * light.shape[1] / TURNS), axis=1)
                self._add(pictures, "turned", view, self._rendered(found, view, around, scale), name)
                turned()

    def _rendered(
        self, found: TexturedReconstruction, views: Sequence[View], light: np.ndarray | None, scale: torch.Tensor | None
    ) -> Images:
        environment = None if light is None else LatLongEnvironment(torch.from_numpy(light).to(found.device))
        drawn = found.render([view.camera for view in views], light=environment, albedo_scale=scale, quality=QUALITY)
        assert drawn is not None
        return drawn

    def _add(self, pictures: Pictures, name: str, views: Sequence[View], images: Images | None, light: str | None = None) -> None:
        """Add every view to a sheet, encoded for a display at the exposure of its ``light``; roughness and albedo as they are."""
        for view, image, coverage in zip(views, images.images, images.coverage, strict=True) if images is not None else ():
            if image.ndim == 2:
                values = shown = straight(image[..., None], coverage).clip(0, 1)
            else:
                values, shown = display(image, coverage), display(image, coverage, self._gains[light] if light else 1.0)
            pictures.sheets.setdefault(name, []).append(cut_out(on_grey(shown, coverage), view.mask, self._side))
            pictures.values.setdefault(name, []).append(cut_out(values, view.mask, self._side, beyond=0))


def _light_map(radiance: np.ndarray, exposed_for: np.ndarray) -> np.ndarray:
    """A lat-long light (H, W, 3) as on a display, at the exposure that brings nine tenths of another below mid-grey."""
    gain = 0.5 / max(float(np.quantile(exposed_for.mean(-1), 0.9)), 1e-12)
    return linear_to_srgb((gain * radiance).clip(0, 1))


def _views_of_maps(scene: Scene) -> list[View]:
    if scene.test or not scene.train:
        known = [(view.albedo is not None) + (view.roughness is not None) for view in scene.test]
        return [view for view, parts in zip(scene.test, known, strict=True) if parts == max(known)]
    places = np.linspace(0, len(scene.train) - 1, min(FITTED, len(scene.train))).round().astype(int)
    return [scene.train[place] for place in places]


def _every(images: Images, stride: int) -> Images:
    return Images(images.images[::stride], images.coverage[::stride])


def _images(views: Sequence[View], name: str) -> Images | None:
    """This truth of every view, or its photograph; None where one lacks it."""
    values = [getattr(view, name) for view in views]
    return None if any(value is None for value in values) else Images(tuple(values), tuple(view.mask for view in views))
