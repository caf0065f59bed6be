"""A method that fits nothing: the mean of the photographs, in texture space, is the albedo."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.contract import MethodInfo, Monitor, Problem, Result
from ia_bench.render.reconstruction import TexturedReconstruction


@dataclass(frozen=True)
class Options:
    """What `method.options` takes.

    Attributes:
        texture: Texels along a side of the albedo.
        roughness: Perceptual roughness of everything.
        mean: The mean of the linear albedo; photographs do not tell it from the light's brightness.
    """

    texture: int = 256
    roughness: float = 0.5
    mean: float = 0.3


class PhotographAsAlbedo:
    """The mean of the photographs, in texture space, taken for the albedo under a white light."""

    Options: ClassVar[type] = Options
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"smoke": {"texture": 64}}
    info = MethodInfo(
        uses_prior=False,
        needs=frozenset({"mesh", "uv"}),
        predicts=frozenset({"albedo", "roughness", "view_synthesis", "relighting"}),
    )

    def __init__(self, options: Options) -> None:
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Average the training images over the texels that they show. Nothing is random."""
        stage, gbuffer = problem.stage, problem.gbuffer  # made now, and booked as baking
        started = time.perf_counter()
        size = self.options.texture

        images = torch.stack([torch.from_numpy(view.image) for view in problem.scene.train])
        seen = images.reshape(-1, 3).to(stage.device)[gbuffer.pixel]  # (P, 3), premultiplied
        hit = gbuffer.face >= 0  # (P, S): the points of a pixel that meet the object
        colour = seen / hit.float().mean(1, keepdim=True)
        uv = stage.surface.uv(gbuffer.face[hit].long(), gbuffer.barycentric[hit])
        average, weight = splat(uv, colour[:, None].expand(-1, hit.shape[1], -1)[hit], size)
        albedo = fill_unobserved(average, weight > 0)
        albedo = (albedo * (self.options.mean / albedo.mean())).clamp(0, 1)

        roughness = torch.full((size, size, 1), self.options.roughness, device=stage.device)
        light = torch.ones(16, 32, 3, device=stage.device)
        return Result(
            reconstruction=TexturedReconstruction(stage, Material(albedo, roughness), light),
            seconds={"average": time.perf_counter() - started},
        )
