"""Rays toward a light of a scene, under which every run is scored: traced once, and kept in the cache from one run to the next.

Directions by the light follow from the mesh, the views, the light, the number of samples and the seed, whatever was recovered. So
does whether the object is in their way: a bit each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key, made_on
from ia_bench.scenes.scene import Mesh

VERSION = 1  # of what is kept
MOST_BYTES = 4 * 2**20  # that are kept of a picture; a shipped scene takes .5 MB for each light and half of the samples


class LightRays:
    """What the directions by the light meet in one picture, pass by pass (all of one size).

    The first pass is traced in any case. Where it meets anything else than what was kept, by code that draws other directions or
    by a processor that rounds differently, nothing of that is used.
    """

    def __init__(self, mesh: Mesh, texels: Tensor, picture: Sequence[object], device: torch.device) -> None:
        """``picture`` tells apart, by its repr, what else decides the directions: views, quality, passes."""
        parts = repr((VERSION, *picture)), mesh.vertices, mesh.faces, mesh.normals, texels.cpu()
        self._key = content_key(made_on(device.type, "light-rays"), *parts)
        found = Cache().get(self._key)
        self._kept = None if found is None else found[0]["blocked"]  # (passes, bytes), a bit for each direction
        self._passes: list[Tensor] = []

    def known(self, count: int) -> Tensor | None:
        """Whether the object is in the way of the next pass's directions, (N, count) bool; None: they have to be traced."""
        if self._kept is None or not self._passes:
            return None
        self._passes.append(self._kept[len(self._passes)])
        return torch.from_numpy(np.unpackbits(self._passes[-1].numpy()).view(bool).reshape(-1, count))

    def keep(self, blocked: Tensor) -> None:
        """Take what a pass that was not known has met, (N, count) bool."""
        self._passes.append(torch.from_numpy(np.packbits(blocked.cpu().numpy())))
        if self._kept is not None and not torch.equal(self._kept[0], self._passes[0]):
            self._kept = None

    def end(self) -> None:
        """Keep a picture that is drawn, unless it was known or is too large."""
        if self._kept is None and sum(each.nbytes for each in self._passes) <= MOST_BYTES:
            Cache().put(self._key, {"blocked": torch.stack(self._passes)})
