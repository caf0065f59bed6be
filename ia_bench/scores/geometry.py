"""How far a recovered shape is from the true one, over what the held-out cameras see of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Mesh, View

SIDE = 2  # rays along a side of a pixel
OF_MASKS, OF_SHAPE = ("mask_iou", "missed_share"), ("normals_degrees", "depth", "chamfer")
POINTS = 100_000  # of each shape that the chamfer distance is taken between, at most
NO_MESH = "the scene has no true mesh"
NO_VIEW = "the scene has no held-out view"
NO_MASK = "no held-out view has a mask that shows the object"
NO_PIXEL = "no scored pixel"


@dataclass(frozen=True)
class GeometryScores:
    """One shape against the truth; None where there is none, with the reason.

    Attributes:
        normals_degrees: Mean angle between the shading normals of both shapes along rays of the held-out cameras that hit both.
        depth: Mean absolute difference of the distances along these rays, over the diagonal of the true mesh's box.
        chamfer: Mean distance from a point of either shape that the cameras see to the nearest such point of the other one,
            averaged over both directions, over the same diagonal.
        mask_iou: Sum of the smaller over sum of the larger of mask and coverage, over all pixels; None where all masks are empty.
        missed_share: Share of the pixels with a mask above the threshold that the shape does not cover at all; they count as
            black in every score. None where no pixel is above it.
        reasons: Name -> why it is None.
    """

    normals_degrees: float | None
    depth: float | None
    chamfer: float | None
    mask_iou: float | None
    missed_share: float | None
    reasons: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """What metrics.json stores."""
        return asdict(self)


def score_geometry(found: Stage, true: Mesh | None, views: Sequence[View], mask_threshold: float) -> GeometryScores:
    """Compare a shape with the masks of ``views`` and, where there is a ``true`` one, with that. Cameras count once each."""
    distinct = {view.camera.to_world.tobytes() + repr(vars(view.camera)).encode(): view for view in views}
    seen = [_Seen.of(found, view) for view in distinct.values()]
    if not seen:
        return GeometryScores(None, None, None, None, None, dict.fromkeys(OF_MASKS, NO_VIEW) | _without(NO_VIEW))
    both = either = masked = missed = scored = 0.0
    for view, one in zip(distinct.values(), seen, strict=True):
        coverage = one.hit.reshape(*view.mask.shape, -1).double().mean(-1).numpy()
        both += float(np.minimum(view.mask, coverage).sum())
        either += float(np.maximum(view.mask, coverage).sum())
        masked += float(view.mask.sum())
        inside = view.mask > mask_threshold
        missed += float((inside & (coverage == 0)).sum())
        scored += float(inside.sum())
    masks = both / either if masked else None, missed / scored if scored else None
    reasons = {name: why for name, value, why in zip(OF_MASKS, masks, (NO_MASK, NO_PIXEL), strict=True) if value is None}
    if true is None:
        return GeometryScores(None, None, None, *masks, reasons | _without(NO_MESH))
    stage = Stage(true, found.device)
    truth = [_Seen.of(stage, view) for view in distinct.values()]
    diagonal = float(np.linalg.norm(np.ptp(true.vertices, axis=0)))
    angles, depths = [], []
    for one, other in zip(seen, truth, strict=True):
        shared = one.hit & other.hit
        cosine = (one.normal[shared] * other.normal[shared]).sum(-1).clamp(-1, 1)
        angles.append(torch.rad2deg(torch.acos(cosine)))
        depths.append((one.distance[shared] - other.distance[shared]).abs())
    if not sum(map(len, angles)):
        return GeometryScores(None, None, None, *masks, reasons | _without("no ray hits both shapes"))
    clouds = [_thinned(torch.cat([part.position[part.hit] for part in parts])) for parts in (seen, truth)]
    from scipy.spatial import cKDTree  # only where a mesh was made

    trees = [cKDTree(cloud) for cloud in clouds]
    chamfer = 0.5 * sum(float(trees[1 - side].query(clouds[side])[0].mean()) for side in (0, 1))
    means = (float(torch.cat(values).double().mean()) for values in (angles, depths))
    return GeometryScores(next(means), next(means) / diagonal, chamfer / diagonal, *masks, reasons)


@dataclass(frozen=True)
class _Seen:
    """What a camera's rays (N = H W S) see of a shape: hit (N,), unit normal (N, 3), distance (N,), position (N, 3)."""

    hit: Tensor
    normal: Tensor
    distance: Tensor
    position: Tensor

    @classmethod
    def of(cls, stage: Stage, view: View) -> _Seen:
        origins, directions = (torch.from_numpy(a).reshape(-1, 3).to(stage.device) for a in primary_rays(view.camera, SIDE))
        face, barycentric, distance = stage.rays.intersect(origins, directions)
        points = stage.surface(face, barycentric, origins)
        return cls((face >= 0).cpu(), points.normal.cpu(), distance.cpu(), points.position.cpu())


def _thinned(cloud: Tensor) -> np.ndarray:
    every = -(-len(cloud) // POINTS)
    return cloud[::every].numpy()


def _without(reason: str) -> dict[str, str]:
    return dict.fromkeys(OF_SHAPE, reason)
