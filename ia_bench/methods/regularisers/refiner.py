"""``refiner``: a prior that knows what fits get wrong corrects the finished one (:class:`ia_bench.priors.contract.Refiner`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import UnitInterval
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import FitState, Problem, Regulariser
from ia_bench.methods.photographs import as_photographed, restrict
from ia_bench.methods.regularisers.fusion import Fusion
from ia_bench.priors.validation import refiner_of
from ia_bench.render.renderer import texture_images

DARK = 0.02
"""This share of the mean of the photographs is added to both sides of a quotient of radiances, so that black ones have one."""
SAMPLES = 16
"""A pixel takes so many samples of the light in the pictures of a fit that are to be corrected."""


@dataclass(frozen=True)
class Refine(Regulariser):
    """Albedo and roughness move toward what the prior makes of the fit's renders of the views that it is asked about.

    Attributes:
        albedo: How much of the change of the albedo's logarithm is taken over.
        roughness: How much of the change of the roughness, from a prior that corrects it.
    """

    albedo: UnitInterval = 0.5  # both chosen on development scenes (docs/log/parsimony.md, supervision.md)
    roughness: UnitInterval = 0.25

    def prepare(self, problem: Problem) -> None:
        """The prior must be one that can correct."""
        refiner_of(problem.prior)

    def apply(self, material: Material, state: FitState) -> Material:
        """See the class."""
        fusion = Fusion(state.problem, state.problem.asked_views)
        if not fusion or not (self.albedo or self.roughness):
            return material
        fitted = fitted_views(fusion, material, state.light, state.generator, state.exposures)
        renders = {name: images.cpu() for name, images in fitted.items()}
        corrected = state.refine(renders).values

        def both(name: str) -> tuple[Tensor, Tensor]:
            return fusion.pixels(renders[name]), fusion.pixels(corrected.get(name, renders[name]))

        return fusion.moved(material, (*both("albedo"), self.albedo), (*both("roughness"), self.roughness))


def fitted_views(
    fusion: Fusion, material: Material, light: SampledLight, generator: torch.Generator, exposures: Tensor | None = None
) -> dict[str, Tensor]:
    """What a fit shows in the training views of the ``fusion``, as a prior is to correct it.

    The pictures are those of :meth:`ia_bench.priors.contract.Refiner.refine`; their :func:`evidence` is that of these photographs.
    ``exposures``: the factors (V, 1 or 3) by which photographs of all training views were exposed; None where they are the same.
    """
    renderer, (part, _) = fusion.problem.renderer, restrict(fusion.problem.gbuffer, fusion.views)
    rendered = as_photographed(renderer.render_images(part, material, light, SAMPLES, generator), fusion.views, exposures)
    rendered["radiance"] = rendered["radiance"].clamp_min(0)  # of which a control variate leaves estimates below black
    images = {name: rendered[name] for name in ("albedo", "radiance", "specular")}
    for name, texture in (("roughness", material.roughness), ("evidence", evidence(fusion, rendered, len(material.albedo)))):
        images[name] = texture_images(renderer.surface, part, texture)
    return images


def evidence(fusion: Fusion, renders: Mapping[str, Tensor], size: int) -> Tensor:
    """What photographs together say about each place: a texture (size, size, 2).

    ``renders`` are a fit's "radiance" and "specular" (V, H, W, 3) in the views of the ``fusion``. The first channel is its misfit,
    the root of the mean square of log((photograph + d) / (radiance + d)), of grey values, with d = DARK of the
    photographs' mean; pixels of which only a bound is known (:class:`ia_bench.scenes.scene.View`) have none. The second is how
    much of a highlight the place has been seen in: the root of the mean square of specular / (radiance + d). Means are those of
    :class:`Fusion`.
    """
    photographs = fusion.problem.photographs
    values = photographs.radiance[fusion.entries], fusion.pixels(renders["radiance"]), fusion.pixels(renders["specular"])
    shown, radiance, specular = (each.mean(-1, keepdim=True) for each in values)
    dark = DARK * shown.mean().clamp_min(1e-12)
    misfit = torch.log((shown.clamp_min(0) + dark) / (radiance.clamp_min(0) + dark))
    misfit = misfit * photographs.known[fusion.entries]
    shine = specular / (radiance + dark)
    return fusion.texture(torch.cat([misfit, shine], 1).square(), size).clamp_min(0).sqrt()
