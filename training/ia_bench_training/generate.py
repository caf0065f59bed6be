"""Training images by number: (seed, index) alone decides what image it is, whatever else is rendered beside it.

Eight consecutive images show one object, each from another side, under another light and with other materials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ia_bench_training.lights import Light
from ia_bench_training.objects import make_object
from ia_bench_training.render import MAX_COVERAGE, MIN_COVERAGE, VIEWS, ObjectRenderer, draw_view, expose
from ia_bench_training.shading import DirectLight
from ia_bench_training.shards import CHANNELS, ShardInfo, write_shard

TRIES = 4
"""Draws of an image before its object is given up for another one."""

_OBJECT, _VIEW = 1, 2  # purposes of random streams


def render_group(seed: int, group: int, views: range, size: int, direct: DirectLight) -> tuple[dict[str, Tensor], int]:
    """Images ``views`` (of 0 .. VIEWS - 1) of object ``group``: tensors by name, (V, S, S, C) float16, and rejected draws.

    A draw is rejected if the object covers too little or too much of the frame, or for a value that is not finite.
    """
    finished: dict[int, dict[str, Tensor]] = {}
    rejected, attempt = 0, 0
    while len(finished) < len(views):
        if attempt % TRIES == 0:
            solid = make_object(np.random.default_rng([seed, _OBJECT, group, attempt // TRIES]))
            renderer = ObjectRenderer(solid, direct)
        pending = [k for k in views if k not in finished]
        draws = [draw_view(np.random.default_rng([seed, _VIEW, group, k, attempt]), solid, size) for k in pending]
        face, barycentric = renderer.trace(draws)
        coverage = renderer.coverage(face)
        keep = torch.nonzero((coverage > MIN_COVERAGE) & (coverage < MAX_COVERAGE))[:, 0]
        if len(keep):
            kept = [draws[i] for i in keep]
            images = expose(renderer.render(kept, face[keep], barycentric[keep]), kept)
            halves = {name: image.half() for name, image in images.items()}
            for number, i in enumerate(keep.tolist()):
                image = {name: values[number] for name, values in halves.items()}
                if all(bool(torch.isfinite(values).all()) for values in image.values()):
                    finished[pending[i]] = image
        rejected += len([k for k in pending if k not in finished])
        attempt += 1
    return {name: torch.stack([finished[k][name] for k in views]) for name in CHANNELS}, rejected


def render_images(seed: int, first: int, count: int, size: int, direct: DirectLight) -> tuple[dict[str, Tensor], int]:
    """Images ``first .. first + count - 1`` of a seed: tensors by name and the number of rejected draws."""
    parts, rejected, last = [], 0, first + count
    for group in range(first // VIEWS, (last - 1) // VIEWS + 1):
        views = range(max(first - group * VIEWS, 0), min(last - group * VIEWS, VIEWS))
        images, again = render_group(seed, group, views, size, direct)
        parts.append(images)
        rejected += again
    return {name: torch.cat([part[name] for part in parts]) for name in CHANNELS}, rejected


def render_relit(seed: int, index: int, lights: Sequence[Light], size: int, direct: DirectLight) -> dict[str, Tensor]:
    """Image ``index`` of a seed again, with its object, camera and materials, under each of L <= VIEWS other ``lights``.

    Tensors by name as from :func:`render_images`, (L, S, S, C) float16. The exposure too is the image's own under every light.
    """
    group, view = divmod(index, VIEWS)
    attempt = 0
    while True:  # the draws that render_group would take and reject
        if attempt % TRIES == 0:
            solid = make_object(np.random.default_rng([seed, _OBJECT, group, attempt // TRIES]))
            renderer = ObjectRenderer(solid, direct)
        draw = draw_view(np.random.default_rng([seed, _VIEW, group, view, attempt]), solid, size)
        face, barycentric = renderer.trace([draw])
        attempt += 1
        if not MIN_COVERAGE < float(renderer.coverage(face)) < MAX_COVERAGE:
            continue
        draws, count = [replace(draw, light=light) for light in lights], len(lights)
        same = face.expand(count, *face.shape[1:]), barycentric.expand(count, *barycentric.shape[1:])
        images = {name: image.half() for name, image in expose(renderer.render(draws, *same), draws).items()}
        if all(bool(torch.isfinite(image).all()) for image in images.values()):
            return images


def make_shard(path: Path, seed: int, first: int, count: int, size: int, direct: DirectLight) -> None:
    """Render a shard and write it."""
    tensors, rejected = render_images(seed, first, count, size, direct)
    write_shard(path, tensors, ShardInfo(seed=seed, first=first, count=count, size=size, redrawn=rejected))
