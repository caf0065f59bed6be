"""Light that turns with the camera, as the renderer meets it: views by their rotations."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from ia_bench.render.gbuffer import GBuffer, SurfacePoints
from ia_bench.scenes.turning import TurningLight

TURNS = 16
"""The most turns of the light for which a step of a fit solves its reflections; other views take the nearest of these.
On one circle the nearest of these is about a cell of the sky away, which is what such reflections know of it."""


def turns_of(gbuffer: GBuffer, turning: TurningLight) -> Tensor:
    """(V, 3, 3), which take directions of the object, view by view, into the map of the light."""
    poses = gbuffer.to_world.cpu().numpy()
    return torch.from_numpy(_rotations(turning, poses.tobytes())).to(gbuffer.to_world)


@lru_cache(maxsize=16)
def _rotations(turning: TurningLight, poses: bytes) -> np.ndarray:
    return turning.rotations(np.frombuffer(poses, np.float32).reshape(-1, 4, 4).astype(float)).astype(np.float32)


def spread_turns(turns: Tensor, most: int | None) -> tuple[Tensor, Tensor]:
    """``most`` (None: all) of V rotations (V, 3, 3), by numbers (K,), and which of these K is nearest to each, (V,).

    Every next one is that which is farthest from all before it.
    """
    alike = torch.einsum("aij,bij->ab", turns, turns)  # the trace of the rotation between two falls with its angle
    chosen, nearest = [0], alike[0].clone()
    while len(chosen) < min(most or len(turns), len(turns)):
        chosen.append(int(nearest.argmin()))
        nearest = torch.maximum(nearest, alike[chosen[-1]])
    return torch.tensor(chosen, device=turns.device), alike[:, chosen].argmax(1)


def in_the_light(surface: SurfacePoints, turn: Tensor) -> SurfacePoints:
    """N points whose normals and directions to the camera are those that the map of a light knows; ``turn`` (N, 3, 3)."""
    normal, view = (torch.einsum("nij,nj->ni", turn, each) for each in (surface.normal, surface.view))
    return replace(surface, normal=normal, view=view)
