"""Rays toward a light of a scene, under which every run is scored: traced once, and kept in the cache from one run to the next.

Directions by the light follow from the mesh, the views, the light, the number of samples and the seed, whatever was recovered. So
does whether the object is in their way: a bit each.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.cache import Cache, content_key, made_on
from ia_bench.scenes.scene import Mesh

VERSION = 2  # of what is kept
MOST_BYTES = 4 * 2**20  # that are kept of a picture; a shipped scene takes .5 MB for each light and half of the samples


class LightRays:
    """What the directions by the light meet in one picture, pass by pass (all of one size).

    With each pass the checksum of its points and directions is kept. From the first on that has others, by code or by a processor
    that draws them otherwise, nothing of what was kept is used.
    """

    def __init__(self, mesh: Mesh, texels: Tensor, picture: Sequence[object], device: torch.device) -> None:
        """``picture`` tells apart, by its repr, what else decides the directions: views, quality, passes."""
        parts = repr((VERSION, *picture)), mesh.vertices, mesh.faces, mesh.normals, texels.cpu()
        self._key, self._device = content_key(made_on(device.type, "light-rays"), *parts), device
        found = Cache().get(self._key)
        self._kept = None if found is None else (found[0]["checksums"].tolist(), found[0]["blocked"])  # (passes,), (passes, bytes)
        self._passes: list[Tensor] = []  # a bit for each direction
        self._room = MOST_BYTES  # below 0 for a picture that is too large, of which nothing is held
        self._checksums: list[int] = []

    def known(self, position: Tensor, direction: Tensor, texel: Tensor) -> Tensor | None:
        """Whether the object is in the way of the next pass's directions, (N, K) bool; None where they have to be traced.

        Those are (N, K, 3), from places (N, 3) to the ``texel`` (N, K) of the light, negative where none is asked about.
        """
        if self._room < 0:
            return None
        checksum, place, asked = 0, len(self._checksums), texel >= 0
        for part in (asked, position[asked.any(1)], direction[asked]):  # of the others nothing is defined
            checksum = zlib.crc32(part.cpu().numpy().tobytes(), checksum)
        self._checksums.append(checksum)
        if self._kept is None or place >= len(self._kept[0]) or self._kept[0][place] != checksum:
            self._kept = None
            return None
        self._passes.append(self._kept[1][place])
        bits = np.unpackbits(self._passes[-1].numpy(), count=texel.numel())
        return torch.from_numpy(bits.view(bool).reshape(texel.shape)).to(self._device)

    def keep(self, blocked: Tensor) -> None:
        """Take what a pass that was not known has met, (N, K) bool."""
        self._room -= -(-blocked.numel() // 8)
        if self._room < 0:
            self._passes.clear()
        else:
            self._passes.append(torch.from_numpy(np.packbits(blocked.cpu().numpy())))

    def end(self) -> None:
        """Keep a picture that is drawn, unless it was known, is empty, or too large."""
        if self._kept is None and self._passes:
            Cache().put(self._key, {"checksums": torch.tensor(self._checksums), "blocked": torch.stack(self._passes)})
