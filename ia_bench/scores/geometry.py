"""How far a recovered shape is from the true one, over what the held-out cameras see of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.render.gbuffer import primary_rays
from ia_bench.render.stage import Stage, camera_key
from ia_bench.scenes.scene import Mesh, View

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
        - ``mask_iou``: sum of the smaller over sum of the larger of mask and coverage, over all pixels;
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
    both = either = masked = missed = scored = 0.0
    for view, one in zip(views, seen, strict=True):
        coverage = one.hit.reshape(*view.mask.shape, -1).double().mean(-1).numpy()
        both += float(np.minimum(view.mask, coverage).sum())
        either += float(np.maximum(view.mask, coverage).sum())
        masked += float(view.mask.sum())
        inside = view.mask > mask_threshold
        missed += float((inside & (coverage == 0)).sum())
        scored += float(inside.sum())
    return {
        "mask_iou": both / either if masked else "no held-out view has a mask that shows the object",
        "missed_share": missed / scored if scored else "no scored pixel",
    }


def _against_shape(found: Stage, true: Mesh | None, views: Sequence[View], seen: Sequence[_Seen]) -> dict[str, float | str]:
    if true is None or not views:
        return dict.fromkeys(OF_SHAPE, "the scene has no true mesh" if views else "the scene has no held-out view")
    stage = Stage(true, found.device)
    truth = [_Seen.of(stage, view) for view in views]
    shared = [one.hit & other.hit for one, other in zip(seen, truth, strict=True)]
    if not any(bool(hit.any()) for hit in shared):
        return dict.fromkeys(OF_SHAPE, "no ray hits both shapes")
    triples = list(zip(seen, truth, shared, strict=True))
    cosine = torch.cat([(one.normal[hit] * other.normal[hit]).sum(-1) for one, other, hit in triples]).clamp(-1, 1)
    depth = torch.cat([(one.distance[hit] - other.distance[hit]).abs() for one, other, hit in triples])
    from scipy.spatial import cKDTree  # only where a mesh was made

    clouds = [torch.cat([part.position[part.hit] for part in parts]) for parts in (seen, truth)]
    thin = [cloud[:: -(-len(cloud) // POINTS)].numpy() for cloud in clouds]
    chamfer = 0.5 * sum(float(cKDTree(thin[1 - side]).query(thin[side])[0].mean()) for side in (0, 1))
    diagonal = float(np.linalg.norm(np.ptp(true.vertices, axis=0)))
    means = torch.rad2deg(torch.acos(cosine)).double().mean(), depth.double().mean() / diagonal
    return dict(zip(OF_SHAPE, (*map(float, means), chamfer / diagonal), strict=True))


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
