"""Where a fit starts: an albedo that the prior or the images suggest, and an even light that explains the images' mean."""

from __future__ import annotations

import torch

from ia_bench.material.textures import fill_unobserved, splat
from ia_bench.methods.contract import PixelSamples, Problem
from ia_bench.methods.descent import check_finite
from ia_bench.methods.photographs import light_of_the_mean_image
from ia_bench.methods.two_stage.parameters import Parameters


@torch.no_grad()
def start_albedo(parameters: Parameters, problem: Problem, mean: float, targets: PixelSamples | None) -> None:
    """Set the albedo to the targets averaged over the views in texture space; without any, to the images' mean colour.

    Args:
        parameters: Whose albedo is set.
        problem: Of the fit.
        mean: Over the channels, of the albedo that has the images' colour.
        targets: Of the albedo, None where they do not say which albedo a pixel has.
    """
    albedo, colour = parameters.tensors["albedo"], problem.photographs.mean_radiance
    colour = mean * colour / colour.mean().clamp_min(1e-30)
    albedo.copy_((colour / colour.max().clamp_min(1.0)).clamp(0, 1).expand_as(albedo))
    if targets is None or not bool(targets.weight.any()):  # none, or of views that do not show the mesh
        return
    gbuffer = problem.gbuffer
    hit = (gbuffer.face >= 0) & (targets.weight > 0)
    uv = problem.renderer.surface.uv(gbuffer.face[hit].long(), gbuffer.barycentric[hit])
    covered = (hit.float().mean(1, keepdim=True)).clamp_min(1e-6)
    values = (targets.values["albedo"] / covered)[:, None].expand(-1, gbuffer.subsamples, -1)[hit]
    average, weight = splat(uv, values, problem.plan.texture)
    albedo.copy_(fill_unobserved(average, weight > 0).clamp(0, 1))


@torch.no_grad()
def start_light(parameters: Parameters, problem: Problem, generator: torch.Generator) -> None:
    """Set the light to the even one that gives the albedo at the start the images' mean colour.

    Of all pixels that no mask leaves out, clipped ones among them: a start that is off is left behind, and those that are known
    alone would be too dark.
    """
    log_light, material = parameters.tensors["log_light"], parameters.material()
    believed = torch.nonzero(~problem.photographs.left_out)[:, 0]
    entries = believed if len(believed) else torch.arange(len(problem.gbuffer.pixel), device=problem.device)
    radiance, rendered = light_of_the_mean_image(problem, entries, material, len(log_light), generator)
    check_finite("the rendered {} is NaN or Inf", {"radiance of the start": rendered})
    log_light += torch.log(radiance)
