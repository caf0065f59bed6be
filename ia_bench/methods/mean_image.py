"""The even light under which a material looks as bright, and of the colour, as the training images do in the mean."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.render.renderer import PixelRadiance

PIXELS = 8192  # that the render under light 1 is taken from, at most


@torch.no_grad()
def light_of_the_mean_image(
    problem: Problem,
    entries: Tensor,
    material: Material,
    rows: int,
    generator: torch.Generator,
    check: Callable[[PixelRadiance, Tensor], None] = lambda rendered, pixels: None,
) -> Tensor:
    """Radiance (3,) of that light: images are linear in it, so one render under light 1 tells it.

    Args:
        problem: Whose renderer and G-buffer are used.
        entries: (N,), N >= 1, pixels of the G-buffer that the mean is taken over.
        material: What is lit.
        rows: Of the lat-long map that holds the light.
        generator: Draws the pixels and the samples.
        check: Is shown the render and the G-buffer entries that it is of.
    """
    gbuffer = problem.gbuffer
    count = min(PIXELS, len(entries))
    pixels = entries[torch.randint(len(entries), (count,), generator=generator, device=entries.device)]
    ones = SampledLight.of(torch.ones(rows, 2 * rows, 3, device=gbuffer.pixel.device))
    rendered = problem.renderer.render_pixels(gbuffer, pixels, material, ones, problem.plan.samples, generator)
    check(rendered, pixels)
    return problem.photographs.radiance[entries].mean(0).clamp_min(1e-30) / rendered.radiance.mean(0).clamp_min(1e-8)
