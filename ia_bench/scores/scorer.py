"""Score reconstructions of one scene: take pictures of them as the protocol says, and compare these with the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.progress import Begin, unseen
from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.reconstruction import Quality, Reconstruction, TexturedReconstruction
from ia_bench.render.settings import BROUGHT, REFERENCE
from ia_bench.render.stage import Stage, camera_key
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Mesh, Scene, View
from ia_bench.scores.balls import ball_pictures, log_radiance
from ia_bench.scores.comparison import Predictions
from ia_bench.scores.error_split import VisibleSurface
from ia_bench.scores.evaluate import REDRAWN, Scores, albedo_scale, record_all, score, score_quick
from ia_bench.scores.metrics import METRICS, Undefined, check_weights
from ia_bench.scores.protocol import Protocol

SIDE = 2  # rays along a side of a pixel
POINTS = 100_000  # of each shape that the chamfer distance is taken between, at most
OF_SHAPE = ("normals_degrees", "depth", "chamfer")


def score_geometry(found: Stage, true: Mesh | None, views: Sequence[View], mask_threshold: float) -> dict[str, Any]:
    """Compare a shape with the masks of ``views`` and, where there is a ``true`` one, with that. Cameras count once each.

    Returns:
        Numbers as metrics.json has them, None where there is none, with "reasons": name -> why.

        - ``normals_degrees``: mean angle between the shading normals of both shapes along rays of the cameras that hit both;
        - ``depth``: mean absolute difference of the distances along these rays, over the diagonal of the true mesh's box;
        - ``chamfer``: mean distance from a point of either shape that the cameras see to the nearest such point of the other one,
          averaged over both directions, over the same diagonal;
        - ``mask_iou``: sum of the smaller over sum of the larger of mask and coverage, over all pixels of the photographs;
        - ``missed_share``: share of the pixels with a mask above the threshold that the shape does not cover at all; they count
          as black in every score.
    """
    distinct = list({camera_key(view.camera): view for view in views}.values())
    seen = [_Seen.of(found, view) for view in distinct]
    values = _against_shape(found, true, distinct, seen) | _against_masks(distinct, seen, mask_threshold)
    numbers = {name: None if isinstance(value, str) else value for name, value in values.items()}
    return {**numbers, "reasons": {name: value for name, value in values.items() if isinstance(value, str)}}


def _against_masks(views: Sequence[View], seen: Sequence[_Seen], mask_threshold: float) -> dict[str, float | str]:
    if not views:
        return dict.fromkeys(("mask_iou", "missed_share"), "the scene has no held-out view")
    masks = np.concatenate([view.mask[~view.beyond] for view in views])
    covers = np.concatenate([one.coverage[~view.beyond] for view, one in zip(views, seen, strict=True)])
    inside, both, either = masks > mask_threshold, np.minimum(masks, covers).sum(), np.maximum(masks, covers).sum()
    return {
        "mask_iou": float(both / either) if masks.any() else "no held-out view has a mask that shows the object",
        "missed_share": float((inside & (covers == 0)).sum() / inside.sum()) if inside.any() else "no scored pixel",
    }


def _against_shape(found: Stage, true: Mesh | None, views: Sequence[View], seen: Sequence[_Seen]) -> dict[str, float | str]:
    if true is None or not views:
        return dict.fromkeys(OF_SHAPE, "the scene has no true mesh" if views else "the scene has no held-out view")
    stage = Stage(true, found.device)
    truth = [_Seen.of(stage, view) for view in views]
    shared = [np.intersect1d(one.ray, other.ray, return_indices=True)[1:] for one, other in zip(seen, truth, strict=True)]
    if not any(len(own) for own, _ in shared):
        return dict.fromkeys(OF_SHAPE, "no ray hits both shapes")
    both = [(one, own, other, its) for one, other, (own, its) in zip(seen, truth, shared, strict=True)]
    apart = torch.cat([(one.normal[own] - other.normal[its]).norm(dim=-1) for one, own, other, its in both])  # a chord
    depth = torch.cat([(one.distance[own] - other.distance[its]).abs() for one, own, other, its in both])
    from scipy.spatial import cKDTree  # only where a mesh was made

    clouds = [torch.cat([part.position for part in parts]) for parts in (seen, truth)]
    thin = [cloud[:: -(-len(cloud) // POINTS)].numpy() for cloud in clouds]
    chamfer = 0.5 * sum(float(cKDTree(thin[1 - side]).query(thin[side])[0].mean()) for side in (0, 1))
    diagonal = float(np.linalg.norm(np.ptp(true.vertices, axis=0)))
    means = torch.rad2deg(2 * torch.asin((apart / 2).clamp(max=1))).double().mean(), depth.double().mean() / diagonal
    return dict(zip(OF_SHAPE, (*map(float, means), chamfer / diagonal), strict=True))


@dataclass(frozen=True)
class _Seen:
    """What rays of a camera see: the M that hit the shape, by number, with unit normal, position (M, 3), and distance (M,).

    ``coverage`` (H, W): the share of each pixel's SIDE x SIDE rays that hit.
    """

    ray: np.ndarray
    normal: Tensor
    distance: Tensor
    position: Tensor
    coverage: np.ndarray

    @classmethod
    def of(cls, stage: Stage, view: View) -> _Seen:
        gbuffer = trace_gbuffer([view.camera], stage.rays, SIDE, stage.device)
        entry, place = torch.nonzero(gbuffer.face >= 0, as_tuple=True)
        origins = gbuffer.seen_from(entry)
        points = stage.surface(gbuffer.face[entry, place], gbuffer.barycentric[entry, place], origins)
        ray, distance = gbuffer.pixel[entry] * SIDE**2 + place, (points.position - origins).norm(dim=-1)
        coverage = gbuffer.coverage()[0].double()
        return cls(ray.cpu().numpy(), points.normal.cpu(), distance.cpu(), points.position.cpu(), coverage.cpu().numpy())


MAPS = ("albedo", "roughness", "metallic")


class Scorer:
    """Scores reconstructions of one scene. It knows the truth, a protocol, and nothing of the run that it scores."""

    def __init__(self, scene: Scene, protocol: Protocol, device: torch.device) -> None:
        """``scene`` must have been loaded with its truth; nothing is rendered yet.

        Raises:
            InputError: ``protocol.lpips.weights`` names a file that holds no weights of that network.
        """
        if scene.truth is None:
            raise ValueError("scoring needs a scene that was loaded with its ground truth")
        check_weights(protocol.lpips)
        self._scene, self._protocol, self._device = scene, protocol, device
        self._stage: Stage | None = None
        self.drawn: tuple[TexturedReconstruction, Predictions] | None = None
        """What the reference renderer has drawn for the last full scores, and of which textures; None without textures."""
        lights = dict.fromkeys(view.light for view in scene.novel)
        self._novel = {light: tuple(view for view in scene.novel if view.light == light) for light in lights}
        self._lights: dict[str, Environment] = {
            name: LatLongEnvironment(torch.from_numpy(scene.truth.lights[name]).to(device), name)
            for name in lights
            if name != "train" and name in scene.truth.lights
        }
        train = scene.truth.lights.get("train")
        self._train_light = None if train is None else LatLongEnvironment(torch.from_numpy(train))

    def full(self, reconstruction: Reconstruction, begin: Begin = unseen) -> Scores:
        """Every number of the protocol; and what can be exported is drawn by the reference renderer, too, and scored again.

        Its pictures under novel lights stand for those of a method that renders under its own light alone. ``begin`` shows how
        many of the views are drawn, and compared.
        """
        samples, renderer = self._protocol.samples_per_pixel, reconstruction.renderer
        truth, exported = self._with_light(self._truth(1)), self._exported(reconstruction)
        renders = sum(len(of) for of in (truth.view_synthesis, *(truth.relighting or {}).values()) if of is not None)
        views = (2 if self._protocol.noise == "subtracted" else 1) * renders + len(truth.albedo or ())
        task = begin("scores", max(views, 1) * (2 if exported is None else 3))
        own = self._predict(reconstruction, truth, 1, samples, task.advance)
        redrawn = Predictions() if exported is None else self._predict(exported, self._truth(1), 1, samples, task.advance)
        if own.relighting is None and redrawn.relighting is not None:
            own, renderer = replace(own, relighting=redrawn.relighting), f"{renderer}; under novel lights {REFERENCE}"
        scores = score(own, truth, self._protocol, renderer=renderer, shown=self._shown if truth.albedo is not None else None)
        self.drawn = (reconstruction, own) if isinstance(reconstruction, TexturedReconstruction) else None
        if exported is not None:
            self.drawn = exported, redrawn
            record_all(scores, redrawn, truth, METRICS, REDRAWN)
        if self.drawn is not None:
            scores.counts["textures"] = self.drawn[0].counts()
            if self._scene.turning is not None:  # a method need not heed it: what is scored again is to be what was scored
                turns = getattr(self.drawn[0].environment, "turning", None) is not None
                scores.counts["textures"]["light_turns"] = int(turns)
        task.advance(task.total - task.done)
        scores.geometry.update(self._geometry(None if self.drawn is None else self.drawn[0].mesh))
        for name in self._novel:
            if name != "train" and name not in self._lights:
                scores.reasons[f"per_image.relighting.{name}"] = "left out: the scene has no environment map of this light"
        return scores

    @cached_property
    def _shown(self) -> VisibleSurface | None:
        """The true surface in the pixels of the test views; None where it is not known."""
        truth, given = self._scene.truth, None if self._scene.mesh_is_made else self._scene.mesh
        mesh = given if truth is None or truth.mesh is None else truth.mesh
        cameras = [view.camera for view in self._scene.test]
        return None if mesh is None else VisibleSurface.of(mesh, cameras, self._scene.train, self._device)

    def _geometry(self, recovered: Mesh | None) -> dict[str, Any]:
        """How far the mesh, recovered or made, is from the true one and from the masks; nothing where it is the scene's own."""
        truth, given = self._scene.truth, self._scene.mesh
        mesh, made = recovered or given, self._scene.mesh_is_made
        own = recovered is not None and not recovered.same_as(given)
        if mesh is None or truth is None or not (made or own):
            return {}
        views = self._scene.test or self._scene.novel
        return score_geometry(self._stage_of(mesh), truth.mesh if made else given, views, self._protocol.mask_threshold)

    def pictures(self, reconstruction: Reconstruction) -> Predictions:
        """The pictures of a reconstruction that are scored, of every view."""
        return self._predict(reconstruction, self._with_light(self._truth(1)), 1, self._protocol.samples_per_pixel)

    def quick(self, reconstruction: Reconstruction) -> dict[str, float | None]:
        """The metric columns of curve.csv, from a fixed subset of the views."""
        stride, samples = self._protocol.curve_stride, min(self._protocol.curve_samples, self._protocol.samples_per_pixel)
        truth = self._truth(stride, self._protocol.curve_lights)
        own = self._predict(reconstruction, truth, stride, samples)
        exported = self._exported(reconstruction) if own.relighting is None and truth.relighting else None
        if exported is not None:
            wanted = Predictions(albedo=truth.albedo, relighting=truth.relighting)
            own = replace(own, relighting=self._predict(exported, wanted, stride, samples).relighting)
        return score_quick(own, truth, self._protocol)

    def _truth(self, stride: int, lights: int | None = None) -> Predictions:
        """The truth of every ``stride``-th view, under so many novel lights; None for what the scene lacks, and for the light."""
        test, names = self._scene.test[::stride], list(self._lights)[:lights]
        return Predictions(
            albedo=_true(test, "albedo"),
            roughness=_true(test, "roughness"),
            metallic=_true(test, "metallic"),
            view_synthesis=_true(self._novel.get("train", ())[::stride], "image"),
            relighting={name: images for name in names if (images := _true(self._novel[name][::stride], "image"))} or None,
        )

    def _with_light(self, truth: Predictions) -> Predictions:
        """The same with pictures of the true training light, which curves, and textures that are drawn again, do not score."""
        return replace(truth, **_of_light(self._train_light))

    def _predict(
        self,
        reconstruction: Reconstruction,
        truth: Predictions,
        stride: int,
        samples: int,
        drawn: Callable[[int], None] = lambda views: None,
    ) -> Predictions:
        """The pictures that ``truth`` is compared with, None for what the reconstruction cannot give; ``drawn`` is told of each."""
        protocol, brought = self._protocol, reconstruction.renderer == BROUGHT
        wanted = [name for name in MAPS if getattr(truth, name) is not None]
        halves = 2 if protocol.noise == "subtracted" and not brought else 1
        cameras = [view.camera for view in self._scene.test[::stride]]
        maps = reconstruction.maps(cameras, wanted, points=protocol.map_points) if wanted else {}
        albedo, roughness, metallic = (maps.get(name) for name in MAPS)
        drawn(0 if truth.albedo is None else len(truth.albedo))

        def rendered(light: str, half: int) -> Images | None:
            views, given = self._novel[light][::stride], self._lights.get(light)
            quality = Quality(protocol.render_points, max(1, samples // halves), halves * protocol.seed + half)
            cameras = [view.camera for view in views]
            images = reconstruction.render(cameras, light=given, albedo_scale=asked[light], quality=quality)
            drawn(len(views))
            return images if images is None or brought else images.exposed([view.exposure for view in views])

        asked: dict[str, torch.Tensor | None] = {} if truth.view_synthesis is None else {"train": None}
        scale = None
        if protocol.alignment == "none" or brought:
            scale = np.ones(3)  # what is not aligned, or cannot be any more, needs no truth to be relit
        elif albedo is not None and truth.albedo is not None:
            scale = albedo_scale(albedo, truth.albedo, protocol)
        if truth.relighting and scale is not None:
            asked |= dict.fromkeys(truth.relighting, torch.from_numpy(scale).float().to(self._device))
        pictures = {name: images for name in asked if (images := rendered(name, 0)) is not None}
        recovered, given = [name for name in pictures if name == "train"], [name for name in pictures if name != "train"]
        for names in (recovered, given) if halves == 2 else ():
            for name in names:  # one half after the other, for lights share what a half's rays meet
                first, other = pictures[name], rendered(name, 1)
                pictures[name] = first if other is None else first.averaged(other)
                if other is not None and pictures[name] is first and any(image.any() for image in first.images):
                    break  # no noise under this light: none under the others, under which the same renderer draws
        view_synthesis = pictures.pop("train", None)
        light = _of_light(None if truth.light is None else reconstruction.environment)
        return Predictions(albedo, roughness, view_synthesis, pictures or None, metallic=metallic, **light)

    def _exported(self, reconstruction: Reconstruction) -> TexturedReconstruction | None:
        """The textures and the light of a method with another renderer than the reference; None where there are none."""
        assets = None if reconstruction.renderer == REFERENCE else reconstruction.assets()
        turning = getattr(reconstruction.environment, "turning", None)  # which assets do not tell
        return None if assets is None else TexturedReconstruction.of(assets, self._stage_of(assets.mesh), turning)

    def _stage_of(self, mesh: Mesh) -> Stage:
        """The stage of what was exported, kept for the next scores of the same mesh."""
        if self._stage is None or self._stage.mesh is not mesh:
            self._stage = Stage(mesh, self._device)
        return self._stage


def _of_light(light: Environment | None) -> dict[str, Any]:
    """What stands for a light in Predictions: balls under it and its log radiance, or, for one that is black or NaN, why not."""
    try:
        return {} if light is None else {"light": ball_pictures(light), "log_light": log_radiance(light)}
    except Undefined as reason:
        return {"undefined": dict.fromkeys(("light", "log_light"), str(reason))}


def _true(views: Sequence[View], component: str) -> Images | None:
    """Ground truth (or, for "image", the photographs) of every view; None if there is no view or one lacks it."""
    values = [getattr(view, component) for view in views]
    if not values or any(value is None for value in values):
        return None
    known = tuple(view.valid for view in views) if component == "image" else None  # maps of truth do not saturate
    return Images(tuple(values), tuple(view.mask for view in views), known)
