"""What the training photographs show in the pixels of a G-buffer, and how far each of them can be believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer
from ia_bench.scenes.scene import Scene, View

if TYPE_CHECKING:
    from ia_bench.methods.contract import Problem

INSIDE = 0.4
"""A mask of no more than that leaves a pixel out. Of one that the mesh just fills, a camera's filter may show less than a half."""
PIXELS = 8192
"""At most, of the render that tells the light of the mean image."""
USUAL, LEVEL = (0.04, 4.0), 0.2
"""Photographs whose mean radiance lies in the range USUAL, as in all scenes by which prices and weights were chosen, are compared
as they are, others as if it were LEVEL: what a fit finds must not depend on the unit of the radiance."""


@dataclass(frozen=True)
class Photographs:
    """The P pixels in which training cameras see the mesh, as the photographs have them.

    Attributes:
        radiance: (P, 3), linear, premultiplied by the mask.
        mask: (P, 1), the share of the pixel that the object fills, as the photograph's mask has it.
        known: (P, 1) bool, where the radiance is no lower bound alone, as it is in pixels that are left out; None for everywhere.
        left_out: (P,) bool, where the mesh fills the pixel and the mask leaves it out: wrong masks and poses, a margin that a
            capture cuts off, a mesh that is too large. Nothing that was made of the photograph says anything there.
        unit: Factor of radiance, of photographs and renders alike, at which a loss of absolute radiance compares them.
    """

    radiance: Tensor
    mask: Tensor
    known: Tensor | None
    left_out: Tensor
    unit: float = 1.0

    @classmethod
    def of(cls, scene: Scene, gbuffer: GBuffer) -> Photographs:
        """Those of a ``scene``, whose training cameras the ``gbuffer`` is of; on its device."""

        def pixels(images: Tensor) -> Tensor:
            return images.to(gbuffer.pixel.device).reshape(-1, images.shape[-1])[gbuffer.pixel]

        radiance = pixels(torch.stack([torch.from_numpy(view.image) for view in scene.train]))
        mask = pixels(torch.stack([torch.from_numpy(view.mask) for view in scene.train])[..., None])
        left_out = gbuffer.filled & (mask[:, 0] <= INSIDE)
        known = known_pixels(scene.train)
        known = None if known is None else pixels(known)
        if bool(left_out.any()):
            known = ~left_out[:, None] if known is None else known & ~left_out[:, None]
        inside = radiance[mask[:, 0] > INSIDE]
        mean, (least, most) = float(inside.mean()) if len(inside) else 0.0, USUAL
        unit = 1.0 if least <= mean <= most or not 0 < mean < float("inf") else LEVEL / mean
        return cls(radiance, mask, known, left_out, unit)

    @property
    def mean_radiance(self) -> Tensor:
        """The mean (3,) over the pixels that are not left out; over all where none is left."""
        inside = self.radiance[~self.left_out]
        return (inside if len(inside) else self.radiance).mean(0)


def as_photographed(renders: Mapping[str, Tensor], views: tuple[int, ...], exposures: Tensor | None) -> dict[str, Tensor]:
    """``renders`` (V', H, W, C) of some ``views`` with those that are radiance exposed as these photographs are."""
    if exposures is None:
        return dict(renders)
    factor = exposures[list(views), None, None, None]
    return {name: images if name == "albedo" else factor * images for name, images in renders.items()}


# ---- pixels whose radiance is known from below only: a saturated sensor, an unknown value (``View.valid``) ----


def known_pixels(views: Sequence[View]) -> Tensor | None:
    """``valid`` of views of one size, (V, H, W, 1) bool; None where every pixel of all of them is known."""
    if all(view.valid is None for view in views):
        return None
    return torch.from_numpy(np.stack([view.known for view in views]))[..., None]


def one_sided(target: Tensor, rendered: Tensor, known: Tensor | None) -> Tensor:
    """What a loss compares ``rendered`` (N, 3) with: ``target`` (N, 3), or the render itself where it may be that bright.

    Where ``known`` (N, 1) is False, the target is a lower bound: a brighter render equals what it is compared with, so that any
    loss of their difference is at its least there and has no gradient.
    """
    return target if known is None else torch.where(known, target, torch.maximum(target, rendered.detach()))


# ---- the even light under which a material looks as bright, and of the colour, as the photographs do in the mean ----


@torch.no_grad()
def light_of_the_mean_image(
    problem: Problem, entries: Tensor, material: Material, rows: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Radiance (3,) of that light, with the render that tells it, as images are linear in the light: (P, 3) under light 1.

    Args:
        problem: Whose renderer and G-buffer are used.
        entries: (N,), N >= 1, pixels of the G-buffer that the mean is taken over.
        material: What is lit.
        rows: Of the lat-long map that holds the light.
        generator: Draws the pixels and the samples.
    """
    gbuffer = problem.gbuffer
    pixels = entries[torch.randint(len(entries), (min(PIXELS, len(entries)),), generator=generator, device=entries.device)]
    ones = SampledLight.of(torch.ones(rows, 2 * rows, 3, device=gbuffer.pixel.device))
    rendered = problem.renderer.render_pixels(gbuffer, pixels, material, ones, problem.plan.samples, generator).radiance
    mean = problem.photographs.radiance[entries].mean(0)
    return mean.clamp_min(1e-30) / rendered.mean(0).clamp_min(1e-8), rendered
